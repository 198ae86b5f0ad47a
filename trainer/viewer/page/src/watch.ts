// `corridor watch`: the tabs, and the loop that follows the runs' files.

import { Place, readPlace, writePlace } from "./address";
import { Scene, Track, element, make, seconds, unpack } from "./data";
import { Drive } from "./drive";
import { EpisodeList } from "./episodes";
import { onKeys, stageKeys } from "./keys";
import { Learning, Overview, RunState } from "./learning";
import { Server } from "./server";
import { Second, Stage } from "./stage";
import { Tabs } from "./tabs";
import { say } from "./words";

const POLL_MILLISECONDS = 2000;
type Tab = "learning" | "episodes" | "drive";

// The token leaves the address, which a history keeps and a screen shows; a reload finds it in the tab's own storage.
function forgetAddress(token: string): void {
  try {
    sessionStorage.setItem("corridor-token", token);
  } catch {
    // The browser keeps nothing here: a reload is refused, and says what to open.
  }
  history.replaceState(null, "", `/${location.hash}`);
}

export function watch(data: { token: string; results: string }, stage: Stage, list: EpisodeList): void {
  forgetAddress(data.token);
  const server = new Server(data.token);
  const learning = new Learning();
  const drive = new Drive(stage, server, say);
  const known = new Map<string, RunState>();
  const scenes = new Map<string, { stamp: string; scene: Scene }>(); // what was seen stays, should its run vanish
  const choice = element<HTMLSelectElement>("episode-run");
  const beside = element<HTMLSelectElement>("beside-run");
  const keys = stageKeys(stage, list);
  const none = `There is no run yet in ${data.results}; start one with 'corridor train --run-id ID'.`;
  let tab: Tab = "learning";
  let sceneShown = "";
  let wanted: Place | null = readPlace(); // until its run and episode are on the stage
  let problem = ""; // of the run beside
  element("title").textContent = "Watch";
  document.title = "corridor watch";
  element("subtitle").textContent = data.results;
  for (const id of ["run-choice", "beat"]) element(id).hidden = false;

  const isRecorded = (name: string) => known.get(name)?.scene?.startsWith("recorded") ?? false;
  const read = async (run: RunState): Promise<{ scene: Scene | null; note: string | null }> => {
    const kept = scenes.get(run.name);
    if (kept && (kept.stamp === run.scene || run.status === "gone")) return { scene: kept.scene, note: null };
    const answer: { scene: Scene | null; note: string | null } = await server.get(`api/scene?run=${encodeURIComponent(run.name)}`);
    if (answer.scene && run.scene) scenes.set(run.name, { stamp: run.scene, scene: answer.scene });
    return answer;
  };

  // The same episode of the run that is chosen to stand beside.
  const second = async (number: number, track: Track): Promise<Second | null> => {
    problem = "";
    const name = beside.value;
    if (!name || tab !== "episodes") return null;
    try {
      if (!isRecorded(name)) throw new Error(`${name} has no evaluation of its own yet, so nothing of it is shown beside.`);
      const kept = scenes.get(name)?.scene;
      const there = kept?.episodes.some((record) => record.number === number);
      const { scene }: { scene: Scene } = there
        ? { scene: kept! }
        : await server.get(`api/episode?run=${encodeURIComponent(name)}&number=${number}`);
      const other = await unpack(scene.episodes.find((record) => record.number === number)!, scene.corridor);
      const start = ["p_x", "p_z", "op0_x", "op0_z"];
      const same = start.every((column) => other.at(column, 0) === track.at(column, 0)) && String(other.goal) === String(track.goal);
      if (!same) problem = `Episode ${number} of ${name} begins differently: another seed, or another corridor.`;
      return { track: other, name };
    } catch (error) {
      problem = (error as Error).message;
      return null;
    }
  };
  list.secondOf = second;
  beside.addEventListener("change", () => {
    if (!list.current) return;
    const time = Math.floor(stage.time) * (stage.track?.corridor.decision_seconds ?? 0);
    void list.select(list.current, { time }).then(() => void poll());
  });

  drive.sceneOf = async (name) => {
    const run = known.get(name);
    return run && isRecorded(name) ? (await read(run)).scene : null;
  };
  element("beat").addEventListener("click", () => {
    const number = list.onStage;
    tabs.open("drive", () => void drive.enter(choice.value, isRecorded(choice.value) ? number : null));
    scrollTo(0, 0);
    element("joystick").focus({ preventScroll: true });
  });

  const tabs = new Tabs<Tab>({ learning: "Learning", episodes: "Episodes", drive: "Play it yourself" }, (next, enter) => {
    if (tab === "drive" && next !== "drive") drive.leave();
    const before = tab;
    tab = next;
    stage.pause();
    stage.driving = next === "drive";
    document.body.classList.toggle("driving", next === "drive");
    element(next === "drive" ? "drive-home" : "stage-home").append(element("stage"));
    if (next === "drive" && before !== "drive") {
      if (enter) enter();
      else void drive.enter(known.has(choice.value) ? choice.value : "");
    }
    const kept = scenes.get(choice.value);
    if (next === "episodes" && before === "drive" && kept && sceneShown) void list.setScene(kept.scene, list.current?.number);
    if (next === "learning") learning.draw();
    if (next !== "episodes") writePlace(null);
    say();
    void poll();
  }, (pressed) => {
    if (pressed === "drive") element("joystick").focus({ preventScroll: true });
    else if (pressed === "episodes") list.focus();
  });
  onKeys((event) => (tab === "drive" ? drive.keyDown(event) : tab === "episodes" && keys(event)), (event) => drive.keyUp(event));
  choice.addEventListener("change", () => {
    setBeside();
    void poll();
  });
  learning.onChoice = () => void poll();

  stage.onRest = () => {
    if (tab !== "episodes" || list.onStage === null || list.onStage !== list.current?.number || !stage.track) return;
    const time = seconds(Math.floor(stage.time), stage.track.corridor.decision_seconds);
    writePlace({ run: choice.value, episode: list.onStage, time, beside: beside.value || null });
  };
  addEventListener("hashchange", () => {
    wanted = readPlace();
    if (!wanted) return;
    sceneShown = "";
    if (tab !== "episodes") tabs.open("episodes");
    else void poll();
  });

  // The episode that the address names, into its run's scene if the scene has not chosen it.
  const placed = async (scene: Scene, place: Place): Promise<string> => {
    if (!scene.episodes.some((record) => record.number === place.episode)) {
      try {
        const answer: { scene: Scene } = await server.get(`api/episode?run=${encodeURIComponent(place.run)}&number=${place.episode}`);
        scene.episodes = [...scene.episodes, ...answer.scene.episodes].sort((a, b) => a.number - b.number);
      } catch (error) {
        return (error as Error).message;
      }
    }
    return "";
  };

  let missed = ""; // what the address asked for and there is not
  const showScene = async () => {
    if (wanted && known.size) {
      if (known.has(wanted.run)) {
        choice.value = wanted.run;
        setBeside();
      } else {
        missed = `There is no run ${wanted.run} in ${data.results}; another is shown.`;
        wanted = null;
      }
    }
    const run = known.get(choice.value);
    if (!run) return none;
    if (!run.scene) return missed || (run.problem ?? "No evaluated episode yet; the first one comes with the run's first checkpoint.");
    const stamp = `${run.name} ${run.scene}`;
    const looking = !stage.isPlaying && stage.time > 0 && stage.time < stage.end;
    if (stamp !== sceneShown && looking && sceneShown.startsWith(`${run.name} `))
      return "There is a newer evaluation; it is shown when this episode is over.";
    if (stamp !== sceneShown) {
      const { scene, note } = await read(run);
      if (!scene) return note ?? "";
      const place = wanted?.run === run.name ? wanted : null;
      missed = place ? await placed(scene, place) : sceneShown ? "" : missed;
      if (place?.beside && known.has(place.beside)) beside.value = place.beside;
      sceneShown = stamp;
      wanted = null;
      await list.setScene(scene, place?.episode, place?.seconds);
      if (!place && !matchMedia("(prefers-reduced-motion: reduce)").matches) stage.play();
    }
    element<HTMLButtonElement>("beat").disabled = !isRecorded(run.name);
    return [missed, problem, ...(scenes.get(run.name)?.scene.notes ?? []), run.problem].filter(Boolean).join(" ");
  };

  const setOptions = (select: HTMLSelectElement, options: [string, string][], fallback: string) => {
    if (options.map(([value]) => value).join("/") === [...select.options].map((option) => option.value).join("/")) return;
    const before = select.value;
    select.replaceChildren(...options.map(([value, text]) => make("option", text, { value })));
    select.value = options.some(([value]) => value === before) ? before : fallback;
  };

  const setBeside = () => {
    const others = [...known.keys()].filter((name) => name !== choice.value);
    setOptions(beside, [["", "none"], ...others.map((name): [string, string] => [name, name])], "");
    element("beside-choice").hidden = !others.length;
  };

  let polling = false;
  const poll = async () => {
    if (polling) return;
    polling = true;
    try {
      const asked = learning.wanted.map((name) => `run=${encodeURIComponent(name)}`).join("&");
      const answer: Overview = await server.get(`api/runs?${asked}`);
      const first = known.size === 0;
      const present = new Set(answer.runs.map((run) => run.name));
      for (const run of answer.runs) known.set(run.name, run);
      for (const [name, run] of known)
        if (!present.has(name)) {
          const scene = run.scene ?? scenes.get(name)?.stamp ?? null; // its files may have gone before the folder
          known.set(name, { ...run, scene, status: "gone", problem: "Its folder is gone; shown is what was read before." });
        }
      if (first && answer.runs.length) learning.chosen.add(answer.runs[0].name);
      const names = [...known.keys()];
      setOptions(choice, names.map((name) => [name, name]), names[0] ?? "");
      setBeside();
      drive.setRuns(names);
      learning.update([...known.values()], answer);
      if (learning.wanted.length) setTimeout(poll); // for their curves
      if (tab === "episodes") say(await showScene());
      else if (tab === "learning") say(names.length ? "" : `${none} Or play it yourself.`);
    } catch (error) {
      say((error as Error).message);
    } finally {
      polling = false;
    }
  };
  tabs.open(wanted ? "episodes" : "learning");
  setInterval(() => {
    if (!document.hidden) void poll();
  }, POLL_MILLISECONDS);
}

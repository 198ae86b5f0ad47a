// One page, three uses: a replay from disk, `corridor watch` beside a training run, and a study's report.

import "uplot/dist/uPlot.min.css";
import "./page.css";
import { PageData, Scene, element, make } from "./data";
import { Drive } from "./drive";
import { EpisodeList } from "./episodes";
import { Learning, Overview, RunState } from "./learning";
import { Server } from "./server";
import { Stage } from "./stage";
import { showStudy, wayBack } from "./study";

const POLL_MILLISECONDS = 2000;
type Tab = "learning" | "episodes" | "drive";

function say(...sentences: (string | null | undefined)[]): void {
  const notes = element("notes");
  notes.textContent = sentences.filter(Boolean).join(" ");
  notes.hidden = !notes.textContent;
}

function describe(scene: Scene): string {
  const { run } = scene;
  return `${run.run_id} · ${run.algo}, c = ${run.c}, seed ${run.seed}, ${run.env === "builtin" ? "built-in player" : `player ${run.env}`}`;
}

function start(data: PageData): void {
  if (data.mode === "study") {
    element("title").textContent = data.study.title;
    element("subtitle").textContent = data.study.facts.join(" · ");
    say(...data.study.notes);
    showStudy(data.study);
    return;
  }
  const stage = new Stage();
  const list = new EpisodeList(stage, say);
  (window as any).corridor = { stage, list }; // for a look from the browser's console
  const keys = (event: KeyboardEvent): boolean => {
    const actions: Record<string, () => void> = {
      " ": () => stage.toggle(),
      ArrowRight: () => stage.step(event.shiftKey ? 10 : 1),
      ArrowLeft: () => stage.step(event.shiftKey ? -10 : -1),
      ArrowDown: () => list.move(1),
      ArrowUp: () => list.move(-1),
      Home: () => stage.seek(0),
      End: () => stage.seek(stage.end),
      c: () => stage.resetCamera(),
    };
    actions[event.key]?.();
    return event.key in actions;
  };
  if (data.mode === "replay") {
    element("title").textContent = "Replay";
    document.title = `${data.scene.run.run_id} · corridor replay`;
    element("subtitle").textContent = describe(data.scene);
    element("subtitle").after(...[wayBack()].filter((link) => link !== null));
    say(...data.scene.notes);
    element("episodes").hidden = false;
    onKeys(keys);
    void list.setScene(data.scene);
    return;
  }
  watch(data, stage, list, keys);
}

function onKeys(handle: (event: KeyboardEvent) => boolean, up: (event: KeyboardEvent) => void = () => {}): void {
  document.addEventListener("keydown", (event) => {
    const target = event.target as HTMLElement;
    const own = target.matches("select, input:not([type=range])") || (target.matches("button") && event.key === " ");
    if (event.ctrlKey || event.metaKey || event.altKey || own) return;
    if (handle(event)) event.preventDefault();
  });
  document.addEventListener("keyup", up);
}

// The token leaves the address, which a history keeps and a screen shows; a reload finds it in the tab's own storage.
function forgetAddress(token: string): void {
  try {
    sessionStorage.setItem("corridor-token", token);
  } catch {
    // The browser keeps nothing here: a reload is refused, and says what to open.
  }
  history.replaceState(null, "", "/");
}

function watch(data: { token: string; results: string }, stage: Stage, list: EpisodeList, keys: (event: KeyboardEvent) => boolean): void {
  forgetAddress(data.token);
  const server = new Server(data.token);
  const learning = new Learning();
  const drive = new Drive(stage, server, say);
  const known = new Map<string, RunState>();
  const choice = element<HTMLSelectElement>("episode-run");
  let tab: Tab = "learning";
  let sceneShown = "";
  let scene: Scene | null = null;
  element("title").textContent = "Watch";
  document.title = "corridor watch";
  element("subtitle").textContent = data.results;
  element("run-choice").hidden = false;

  const open = (next: Tab) => {
    if (tab === "drive" && next !== "drive") drive.leave();
    tab = next;
    stage.pause();
    stage.driving = next === "drive";
    document.body.classList.toggle("driving", next === "drive");
    for (const name of ["learning", "episodes", "drive"]) element(name).hidden = name !== next;
    document.querySelectorAll<HTMLElement>("#tabs button").forEach((button) => {
      button.setAttribute("aria-selected", String(button.dataset.tab === next));
    });
    element(next === "drive" ? "drive-home" : "stage-home").append(element("stage"));
    if (next === "drive") void drive.enter();
    if (next === "episodes" && scene) void list.setScene(scene);
    if (next === "learning") learning.draw();
    say();
    void poll();
  };
  for (const [name, text] of [["learning", "Learning"], ["episodes", "Episodes"], ["drive", "Play it yourself"]] as const) {
    const button = make("button", text);
    button.dataset.tab = name;
    button.setAttribute("role", "tab");
    button.addEventListener("click", () => open(name));
    element("tabs").append(button);
  }
  onKeys((event) => (tab === "drive" ? drive.keyDown(event) : tab === "episodes" && keys(event)), (event) => drive.keyUp(event));
  choice.addEventListener("change", () => void poll());
  learning.onChoice = () => void poll();

  const showScene = async () => {
    const run = known.get(choice.value);
    if (!run) return "There is no run yet; start one with 'corridor train --run-id ID'.";
    if (!run.scene) return run.problem ?? "No evaluated episode yet; the first one comes with the run's first checkpoint.";
    const wanted = `${run.name} ${run.scene}`;
    const looking = !stage.isPlaying && stage.time > 0 && stage.time < stage.end;
    if (wanted !== sceneShown && looking && sceneShown.startsWith(`${run.name} `))
      return "There is a newer evaluation; it is shown when this episode is over.";
    if (wanted !== sceneShown) {
      const answer: { scene: Scene | null; note: string | null } = await server.get(`api/scene?run=${encodeURIComponent(run.name)}`);
      if (!answer.scene) return answer.note ?? "";
      scene = answer.scene;
      sceneShown = wanted;
      await list.setScene(scene);
      stage.play();
    }
    return [...(scene?.notes ?? []), run.problem].filter(Boolean).join(" ");
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
        if (!present.has(name)) known.set(name, { ...run, status: "gone", problem: "Its folder is gone; shown is what was read before." });
      if (first && answer.runs.length) learning.chosen.add(answer.runs[0].name);
      const names = [...known.keys()];
      if (names.join("/") !== [...choice.options].map((option) => option.value).join("/")) {
        const before = choice.value;
        choice.replaceChildren(...names.map((name) => make("option", name, { value: name })));
        choice.value = names.includes(before) ? before : names[0];
      }
      learning.update([...known.values()], answer);
      if (learning.wanted.length) setTimeout(poll); // for their curves
      if (tab === "episodes") say(await showScene());
      else if (tab === "learning") say(names.length ? "" : "There is no run yet; start one with 'corridor train --run-id ID'. Or play it yourself.");
    } catch (error) {
      say((error as Error).message);
    } finally {
      polling = false;
    }
  };
  open("learning");
  setInterval(() => {
    if (!document.hidden) void poll();
  }, POLL_MILLISECONDS);
}

try {
  start(JSON.parse(element("data").textContent!));
} catch (error) {
  say(`This page's data is broken and can't be shown (${(error as Error).message}).`);
}

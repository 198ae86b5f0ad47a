// Driving the learner by hand, against the world in the local process: in a run's corridor, in a new episode or in one
// that the run's policy was evaluated on.

import { Corridor, EpisodeRecord, Outcome, Scene, Track, element, make, seconds, signed, unpack } from "./data";
import { CASES, Case, amounts, caseOf } from "./events";
import { Server } from "./server";
import { Stage } from "./stage";

interface Row {
  values: Record<string, number>;
  outcome: Outcome | null;
}

const KEYS: Record<string, [number, number]> = {
  ArrowUp: [0, 1], ArrowDown: [0, -1], ArrowLeft: [-1, 0], ArrowRight: [1, 0],
  w: [0, 1], s: [0, -1], a: [-1, 0], d: [1, 0],
};
const RESULT = { goal: "Target reached.", failed: "Failed.", truncated: "Cut by the step limit.", ended: "Ended." };
const DEFAULT = ""; // the choice of no run: the player's default corridor

interface Begun {
  session: string;
  seed: number | null;
  corridor: Corridor;
  goal: [number, number];
  opponent_targets: [number, number][];
  row: Row;
}

export class Drive {
  // A run's recorded evaluation, whose episodes can be driven; null if it has none.
  sceneOf: (run: string) => Promise<Scene | null> = async () => null;
  private readonly down = new Set<string>();
  private readonly runs = element<HTMLSelectElement>("drive-run");
  private readonly episodes = element<HTMLSelectElement>("drive-episode");
  private pad: [number, number] = [0, 0];
  private track: Track | null = null;
  private session = "";
  private seed: number | null = null; // of a new episode, to begin it again
  private record: EpisodeRecord | null = null; // whose start it is
  private scene: Scene | null = null;
  private active = false;
  private game = 0;
  private counts = new Map<Case | "failure", { steps: number; sum: number }>();

  constructor(private readonly stage: Stage, private readonly server: Server, private readonly onError: (message: string) => void) {
    element("again").addEventListener("click", () => void this.begin(true));
    element("new-episode").addEventListener("click", () => this.another());
    this.runs.append(make("option", "the player's default", { value: DEFAULT }));
    this.runs.addEventListener("change", () => void this.enter(this.runs.value));
    this.episodes.addEventListener("change", () => {
      this.choose(this.episodes.value === "" ? null : Number(this.episodes.value));
      void this.begin(false);
    });
    window.addEventListener("blur", () => this.down.clear());
    this.makePad();
  }

  // The runs that there are; a choice stays.
  setRuns(names: string[]): void {
    const all = [...names, DEFAULT];
    if (all.join("/") === [...this.runs.options].map((option) => option.value).join("/")) return;
    const before = this.runs.value;
    this.runs.replaceChildren(...all.map((name) => make("option", name || "the player's default", { value: name })));
    this.runs.value = all.includes(before) ? before : DEFAULT;
  }

  // run: in whose corridor; episode: as which of its evaluation's episodes it begins, or null for a new one.
  async enter(run: string, episode: number | null = null): Promise<void> {
    this.active = true;
    this.game += 1;
    element("drive-controls").hidden = false;
    this.runs.value = run;
    this.scene = run === DEFAULT ? null : await this.sceneOf(run).catch(() => null);
    if (!this.active || this.runs.value !== run) return;
    this.episodes.replaceChildren(
      make("option", "new each time", { value: "" }),
      ...(this.scene?.episodes ?? []).map((record) =>
        make("option", `episode ${record.number}, ${record.outcome === "goal" ? "reached" : "not reached"}, ${signed(record.return, 2)}`, { value: String(record.number) })),
    );
    this.choose(episode);
    await this.begin(false);
  }

  leave(): void {
    this.active = false;
    this.game += 1;
    this.down.clear();
    this.track = null;
    this.stage.ghost = null;
    element("drive-controls").hidden = true;
  }

  private choose(episode: number | null): void {
    this.record = this.scene?.episodes.find((record) => record.number === episode) ?? null;
    this.episodes.value = this.record ? String(this.record.number) : "";
  }

  private another(): void {
    this.choose(null);
    void this.begin(false);
  }

  // Returns whether the key drives.
  keyDown(event: KeyboardEvent): boolean {
    const name = event.key.length === 1 ? event.key.toLowerCase() : event.key;
    if (name === "r") void this.begin(true);
    else if (name === "n") this.another();
    else if (name in KEYS) this.down.add(name);
    else return false;
    return true;
  }

  keyUp(event: KeyboardEvent): void {
    this.down.delete(event.key.length === 1 ? event.key.toLowerCase() : event.key);
  }

  get action(): [number, number] {
    let [x, z] = this.pad;
    for (const name of this.down) {
      x += KEYS[name][0];
      z += KEYS[name][1];
    }
    return [Math.max(-1, Math.min(1, x)), Math.max(-1, Math.min(1, z))];
  }

  // again: the episode that was driven last, from its start.
  private async begin(again: boolean): Promise<void> {
    const game = ++this.game;
    const { record, scene } = this;
    try {
      const begun: Begun = await this.server.post("api/drive/new", {
        run: this.runs.value || null, episode: record?.number ?? null, seed: again ? this.seed : null,
      });
      const ghost = record && scene ? await unpack(record, scene.corridor) : null;
      if (game !== this.game) return;
      this.session = begun.session;
      this.seed = begun.seed;
      const track = new Track(begun.corridor, begun.goal, begun.opponent_targets, begun.opponent_targets.length, null);
      track.push(begun.row.values);
      this.track = track;
      this.counts.clear();
      const beat = record ? ` The policy's return was ${signed(record.return, 3)}: beat it.` : "";
      element("drive-result").textContent = `The clock starts with your first move.${beat}`;
      element("drive-title").textContent = record ? `You drive episode ${record.number}` : "You drive";
      this.account();
      this.stage.ghost = ghost;
      this.stage.show(track);
      void this.run(game, track);
    } catch (error) {
      this.onError((error as Error).message);
    }
  }

  // One request per decision, in the world's own time.
  private async run(game: number, track: Track): Promise<void> {
    const period = 1000 * track.corridor.decision_seconds;
    let next = performance.now();
    while (this.active && game === this.game) {
      const [x, z] = this.action;
      if (track.rows === 1 && x === 0 && z === 0) {
        await pause(20);
        next = performance.now();
        continue;
      }
      let row: Row;
      try {
        row = await this.server.post("api/drive/step", { session: this.session, action: [x, z] });
      } catch (error) {
        this.onError((error as Error).message);
        return;
      }
      if (game !== this.game) return;
      track.push(row.values);
      track.outcome = row.outcome;
      if (track.rows === 2) element("drive-result").textContent = "";
      this.account();
      this.stage.grown(row.outcome !== null || track.rows % 5 === 0);
      if (row.outcome) {
        element("drive-result").textContent = this.result(track, row.outcome);
        return;
      }
      next = Math.max(next + period, performance.now());
      await pause(next - performance.now());
    }
  }

  private result(track: Track, outcome: Outcome): string {
    const { corridor } = track;
    const mine = track.returns.at(-1)!;
    const time = (rows: number) => `${seconds(rows, corridor.decision_seconds)} s`;
    const own = `${RESULT[outcome]} Return ${signed(mine, 3)} in ${time(track.rows - 1)}`;
    if (!this.record) return `${own}.`;
    const verdict = mine > this.record.return ? "beaten" : "not beaten";
    return `${own}; the policy's ${signed(this.record.return, 3)} in ${time(this.record.length)} is ${verdict}.`;
  }

  private account(): void {
    const track = this.track!;
    const row = track.rows - 1;
    const found = caseOf(track, row);
    const add = (name: Case | "failure", reward: number) => {
      const count = this.counts.get(name) ?? { steps: 0, sum: 0 };
      this.counts.set(name, { steps: count.steps + 1, sum: count.sum + reward });
    };
    if (found) {
      const penalty = track.corridor.failure_penalty;
      add(found.name, track.at("reward", row) + (found.failed ? penalty : 0));
      if (found.failed) add("failure", -penalty);
    }
    const line = (name: Case | "failure", text: string, amount: string) => {
      const count = this.counts.get(name);
      const now = found?.name === name || (name === "failure" && found?.failed);
      const tr = make("tr", "", { className: now ? "now" : "" });
      const what = make("td", text);
      what.append(make("small", amount));
      tr.append(what, make("td", count ? `${count.steps}×` : "", { className: "number" }), make("td", count ? signed(count.sum, 3) : "", { className: "number" }));
      return tr;
    };
    const total = make("tr", "", { className: "total" });
    total.append(make("td", "return"), make("td", `${row}×`, { className: "number" }), make("td", signed(track.returns[row], 3), { className: "number" }));
    const pays = amounts(track.corridor);
    const failure = track.corridor;
    element("accrued").replaceChildren(
      line("goal", CASES.goal, pays.goal), line("wall", CASES.wall, pays.wall), line("contact", CASES.contact, pays.contact),
      line("near", "in the near zone", pays.near), line("step", CASES.step, pays.step),
      line("failure", `failed, at a return of ${signed(failure.failure_return, 0)}`, signed(-failure.failure_penalty, 1).replace(".0", "")), total,
    );
  }

  private makePad(): void {
    const pad = element("joystick");
    const knob = pad.querySelector("i")!;
    const move = (event: PointerEvent) => {
      const box = pad.getBoundingClientRect();
      const reach = box.width / 2 - 20;
      const clamp = (value: number) => Math.max(-1, Math.min(1, value));
      this.pad = [clamp((event.clientX - box.left - box.width / 2) / reach), clamp(-(event.clientY - box.top - box.height / 2) / reach)];
      const length = Math.max(1, Math.hypot(...this.pad));
      knob.style.transform = `translate(${(this.pad[0] / length) * reach}px, ${(-this.pad[1] / length) * reach}px)`;
    };
    pad.addEventListener("pointerdown", (event) => {
      pad.setPointerCapture(event.pointerId);
      move(event);
      event.preventDefault();
    });
    pad.addEventListener("pointermove", (event) => {
      if (pad.hasPointerCapture(event.pointerId)) move(event);
    });
    for (const end of ["pointerup", "pointercancel"] as const)
      pad.addEventListener(end, () => {
        this.pad = [0, 0];
        knob.style.transform = "";
      });
  }
}

function pause(milliseconds: number): Promise<void> {
  return new Promise((resolve) => setTimeout(resolve, Math.max(milliseconds, 0)));
}

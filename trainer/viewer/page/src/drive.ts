// Driving the learner by hand, against the world in the local process.

import { CASES, Case, Corridor, Outcome, Track, caseOf, element, make, signed } from "./data";
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
const RESULT = {
  goal: "Target reached.", failed: "Failed: the rewards added up to −1, so eq. 9's episode ends and 1 more is subtracted.",
  truncated: "Cut by the step limit.", ended: "Ended.",
};

export class Drive {
  private readonly down = new Set<string>();
  private pad: [number, number] = [0, 0];
  private track: Track | null = null;
  private session = "";
  private active = false;
  private game = 0;
  private counts = new Map<Case | "failure", { steps: number; sum: number }>();

  constructor(private readonly stage: Stage, private readonly server: Server, private readonly onError: (message: string) => void) {
    element("new-episode").addEventListener("click", () => void this.begin());
    window.addEventListener("blur", () => this.down.clear());
    this.makePad();
  }

  async enter(): Promise<void> {
    this.active = true;
    element("joystick").hidden = false;
    if (this.track) this.stage.show(this.track, this.track.rows - 1);
    else await this.begin();
  }

  leave(): void {
    this.active = false;
    this.game += 1;
    this.down.clear();
    this.track = null;
    element("joystick").hidden = true;
  }

  // Returns whether the key drives.
  keyDown(event: KeyboardEvent): boolean {
    const name = event.key.length === 1 ? event.key.toLowerCase() : event.key;
    if (name === "r") void this.begin();
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

  private async begin(): Promise<void> {
    const game = ++this.game;
    try {
      const begun: { session: string; corridor: Corridor; goal: [number, number]; opponent_targets: [number, number][]; row: Row } =
        await this.server.post("api/drive/new", {});
      if (game !== this.game) return;
      this.session = begun.session;
      const track = new Track(begun.corridor, begun.goal, begun.opponent_targets, begun.opponent_targets.length, null);
      track.push(begun.row.values);
      this.track = track;
      this.counts.clear();
      element("drive-result").textContent = "The clock starts with your first move.";
      this.account();
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
        element("drive-result").textContent = `${RESULT[row.outcome]} Return ${signed(track.returns.at(-1)!, 3)}.`;
        return;
      }
      next = Math.max(next + period, performance.now());
      await pause(next - performance.now());
    }
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
      add(found.name, track.at("reward", row) + (found.failed ? 1 : 0));
      if (found.failed) add("failure", -1);
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
    element("accrued").replaceChildren(
      line("goal", CASES.goal, "1"), line("wall", CASES.wall, "−0.1"), line("contact", CASES.contact, "−0.25"),
      line("near", "in the near zone", "−0.1 − (1 − d_opp) / 4"), line("step", CASES.step, "−0.001"),
      line("failure", "failed, at a return of −1", "−1"), total,
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

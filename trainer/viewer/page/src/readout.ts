// The numbers of one episode at one time.

import { Track, make, signed } from "./data";
import { CASES, caseOf } from "./events";

type Entry = "run" | "reward" | "return" | "d" | "switch" | "goal" | "value" | "intrinsic" | "case";
const LABELS: Record<Entry, string> = {
  run: "run", reward: "reward", return: "return so far", d: "d_opp", switch: "switch", goal: "to the target",
  value: "value", intrinsic: "c · r_i", case: "eq. 9 says",
};

export class Readout {
  private readonly values = new Map<Entry, HTMLElement>();

  constructor(private readonly home: HTMLElement) {
    for (const [name, label] of Object.entries(LABELS) as [Entry, string][]) {
      const box = make("div", "", { className: name === "case" ? "case" : name === "run" ? "run" : "wide" });
      const value = make("b");
      box.append(make("small", label), value);
      home.append(box);
      this.values.set(name, value);
    }
  }

  // run: whose numbers they are, where there are two.
  show(track: Track | null, time: number, run: string | null): void {
    this.home.hidden = track === null;
    if (!track) return;
    const row = Math.min(Math.floor(time), track.rows - 1);
    const found = caseOf(track, row);
    const scale = track.corridor.half_length;
    const toGoal = Math.hypot(track.goal[0] - track.at("p_x", row) * scale, track.goal[1] - track.at("p_z", row) * scale);
    const estimate = (column: string, digits: number) =>
      !track.columns.has(column) ? null : column === "intrinsic" && row === 0 ? "–" : signed(track.at(column, row), digits);
    this.put("run", run);
    this.put("reward", row ? signed(track.at("reward", row), 3) : "–");
    this.put("return", signed(track.returns[row], 3));
    this.put("d", track.nearest(row).toFixed(3));
    this.put("switch", track.at("switch", row) > 0.5 ? "on" : "off");
    this.put("goal", `${toGoal.toFixed(1)} m`);
    this.put("value", estimate("value", 2));
    this.put("intrinsic", estimate("intrinsic", 4));
    const failed = found?.failed ? `; failed: ${signed(-track.corridor.failure_penalty, 2).replace(/\.?0+$/, "")} more` : "";
    this.put("case", row === 0 ? "–" : found ? CASES[found.name] + failed : "–");
  }

  private put(name: Entry, text: string | null): void {
    const node = this.values.get(name)!;
    node.parentElement!.hidden = text === null;
    if (text !== null && node.textContent !== text) node.textContent = text;
  }
}

// What happens in an episode: which case of eq. 9 paid each decision, and where the time line has its marks.

import { Corridor, Track, signed } from "./data";

export type Case = "goal" | "wall" | "contact" | "near" | "step";
export const CASES: Record<Case, string> = {
  goal: "target reached, switch on",
  wall: "into a wall",
  contact: "touching the opponent",
  near: "in the opponent's near zone",
  step: "any other step",
};

// What each case pays, as it is written; "d" stands for d_opp.
export function amounts(corridor: Corridor): Record<Case, string> {
  const number = (value: number) => signed(+value.toPrecision(4), 4).replace(/\.?0+$/, "");
  return {
    goal: number(corridor.goal_reward),
    wall: number(-corridor.wall_penalty),
    contact: number(-corridor.contact_penalty),
    near: `${number(-corridor.near_penalty)} − (1 − d_opp) / 4`,
    step: number(-corridor.step_penalty),
  };
}

// The case that paid this decision's reward, and whether the episode failed with it; null if none gives this number.
export function caseOf(track: Track, row: number): { name: Case; failed: boolean } | null {
  if (row < 1 || row >= track.rows) return null;
  const { corridor } = track;
  const reward = track.at("reward", row);
  const last = row === track.rows - 1 && track.outcome === "failed";
  const paid: [Case, number][] = [
    ["goal", corridor.goal_reward],
    ["wall", -corridor.wall_penalty],
    ["contact", -corridor.contact_penalty],
    ["step", -corridor.step_penalty],
    ["near", -corridor.near_penalty - (1 - track.nearest(row)) / 4],
  ];
  for (const failed of last ? [true, false] : [false])
    for (const [name, amount] of paid)
      if (Math.abs(reward - amount + (failed ? corridor.failure_penalty : 0)) < 1e-6) return { name, failed };
  return null;
}

export type Mark = "switch" | "near" | "contact" | "wall" | "end";

// Decisions in a row with the same mark: those after row `from`, up to row `to`.
export interface Span {
  mark: Mark;
  from: number;
  to: number;
}

export function spans(track: Track): Span[] {
  const found: Span[] = [];
  const last = new Map<Mark, Span>();
  const add = (mark: Mark, row: number) => {
    const before = last.get(mark);
    if (before && before.to === row - 1) before.to = row;
    else {
      const span = { mark, from: row - 1, to: row };
      found.push(span);
      last.set(mark, span);
    }
  };
  const switched = track.columns.get("switch")!;
  for (let row = 1; row < track.rows; row++) {
    const paid = caseOf(track, row)?.name;
    if (paid === "near" || paid === "contact" || paid === "wall") add(paid, row);
    if (switched[row] > 0.5 && switched[row - 1] <= 0.5) found.push({ mark: "switch", from: row, to: row });
  }
  if (track.outcome) found.push({ mark: "end", from: track.rows - 1, to: track.rows - 1 });
  return found;
}

// What Python hands to the page (trainer/viewer/corridor_scene.py, trainer/viewer/page_server.py), and episodes unpacked from it.

export interface Corridor {
  half_length: number;
  half_width: number;
  agent_radius: number;
  opponent_radius: number;
  goal_radius: number;
  near_distance: number; // half-lengths
  decision_seconds: number;
  failure_return: number;
  switch: { x: number; z: number; radius: number } | null;
}

export interface RunFacts {
  run_id: string;
  env: string;
  preset: string;
  algo: string;
  seed: number;
  c: number;
  penalty: number;
  steps: number;
}

export type Outcome = "goal" | "failed" | "truncated" | "ended";

export interface EpisodeRecord {
  number: number;
  length: number;
  outcome: Outcome;
  return: number;
  closest: number;
  goal: [number, number];
  opponent_targets: [number, number][] | null;
  opponents: number;
  columns: string[];
  data: string;
}

export interface Scene {
  run: RunFacts;
  env_steps: number;
  corridor: Corridor;
  evaluated: number;
  notes: string[];
  episodes: EpisodeRecord[];
}

export interface Claim {
  id: string;
  statement: string;
  measure: string;
  holds: boolean | null;
  evidence: string;
}

export interface Result {
  label: string;
  runs: number | null;
  measures: Record<string, [number, number, number] | null>; // value, and its interval's ends
}

export interface Study {
  title: string;
  facts: string[];
  figures: { title: string; caption: string; source: string }[];
  claims: Claim[];
  results: Result[];
  groups: { name: string; runs: { run_id: string; evaluation: Record<string, number | null> | null; replay: string | null }[] }[];
  notes: string[];
}

export type PageData =
  | { mode: "replay"; scene: Scene }
  | { mode: "watch"; token: string; results: string }
  | { mode: "study"; study: Study };

// An episode as columns over its states; it grows while somebody drives.
export class Track {
  readonly columns = new Map<string, number[] | Float32Array>();
  rows = 0;
  readonly returns: number[] = [];

  constructor(
    readonly corridor: Corridor,
    readonly goal: [number, number],
    readonly targets: [number, number][] | null,
    readonly opponents: number,
    public outcome: Outcome | null,
  ) {}

  at(column: string, row: number): number {
    return this.columns.get(column)![row];
  }

  // Position in metres between two states.
  place(name: string, time: number): [number, number] {
    const row = Math.min(Math.floor(time), this.rows - 1);
    const next = Math.min(row + 1, this.rows - 1);
    const part = time - row;
    const scale = this.corridor.half_length;
    const between = (column: string) => {
      const a = this.at(column, row);
      return scale * (a + (this.at(column, next) - a) * part);
    };
    return [between(`${name}_x`), between(`${name}_z`)];
  }

  nearest(row: number): number {
    let least = Infinity;
    for (let k = 0; k < this.opponents; k++) least = Math.min(least, this.at(`op${k}_d`, row));
    return least;
  }

  // Row at which the switch turned on, or null.
  get switchRow(): number | null {
    const column = this.columns.get("switch")!;
    for (let row = 0; row < this.rows; row++) if (column[row] > 0.5) return row;
    return null;
  }

  push(values: Record<string, number>): void {
    for (const [name, value] of Object.entries(values)) {
      if (!this.columns.has(name)) this.columns.set(name, []);
      (this.columns.get(name) as number[]).push(value);
    }
    this.rows += 1;
    this.returns.push((this.returns.at(-1) ?? 0) + values.reward);
  }
}

export async function unpack(record: EpisodeRecord, corridor: Corridor): Promise<Track> {
  const packed = Uint8Array.from(atob(record.data), (letter) => letter.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  const shuffled = new Uint8Array(await new Response(stream).arrayBuffer());
  const rows = record.length + 1;
  const count = rows * record.columns.length;
  if (shuffled.length !== 4 * count) throw new Error(`Episode ${record.number} is broken: its table has a wrong size.`);
  const bytes = new Uint8Array(4 * count);
  for (let byte = 0; byte < 4; byte++)
    for (let i = 0; i < count; i++) bytes[4 * i + byte] = shuffled[byte * count + i];
  const table = new Float32Array(bytes.buffer);
  const track = new Track(corridor, record.goal, record.opponent_targets, record.opponents, record.outcome);
  record.columns.forEach((name, c) => track.columns.set(name, table.subarray(c * rows, (c + 1) * rows)));
  track.rows = rows;
  let total = 0;
  for (let row = 0; row < rows; row++) track.returns.push((total += track.at("reward", row)));
  return track;
}

// Which case of eq. 9 paid this step's reward; null if none gives this number.
export type Case = "goal" | "wall" | "contact" | "near" | "step";
export const CASES: Record<Case, string> = {
  goal: "target reached, switch on",
  wall: "into a wall",
  contact: "touching the opponent",
  near: "in the opponent's near zone",
  step: "any other step",
};

export function caseOf(track: Track, row: number): { name: Case; failed: boolean } | null {
  if (row < 1) return null;
  const d = track.nearest(row);
  const reward = track.at("reward", row);
  const last = row === track.rows - 1 && track.outcome === "failed";
  const amounts: [Case, number][] = [
    ["goal", 1],
    ["wall", -0.1],
    ["contact", -0.25],
    ["step", -0.001],
    ["near", -0.1 - (1 - d) / 4],
  ];
  for (const failed of last ? [true, false] : [false])
    for (const [name, amount] of amounts)
      if (Math.abs(reward - amount + (failed ? 1 : 0)) < 1e-6) return { name, failed };
  return null;
}

export function element<T extends HTMLElement>(id: string): T {
  return document.getElementById(id) as T;
}

export function make<K extends keyof HTMLElementTagNameMap>(
  tag: K,
  text = "",
  properties: Partial<HTMLElementTagNameMap[K]> = {},
): HTMLElementTagNameMap[K] {
  return Object.assign(document.createElement(tag), { textContent: text }, properties);
}

// A number with a true minus sign.
export function signed(value: number, digits: number): string {
  const text = Math.abs(value).toFixed(digits);
  return value < 0 && Number(text) !== 0 ? `−${text}` : text;
}

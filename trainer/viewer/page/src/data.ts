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
  goal_reward: number;
  wall_penalty: number;
  contact_penalty: number;
  near_penalty: number;
  step_penalty: number;
  failure_penalty: number;
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

// Decisions as seconds, with as many digits as the decision period needs: 0.25 s is no 0.3.
export function seconds(decisions: number, period: number): string {
  let digits = 0;
  while (digits < 3 && Math.abs(period * 10 ** digits - Math.round(period * 10 ** digits)) > 1e-6) digits += 1;
  return (decisions * period).toFixed(digits);
}

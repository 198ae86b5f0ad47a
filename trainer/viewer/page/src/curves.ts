// Learning curves as numbers: what a run's rows are along an axis, smoothed, and as a CSV file.

import { XAxis } from "./axes";

export type Columns = Record<string, (number | null)[]>; // of progress.csv

export interface Points {
  x: number[];
  raw: (number | null)[];
  y: (number | null)[]; // smoothed
}

export interface View {
  min: number;
  max: number;
}

// Rows along an axis, which only goes up: of rows in one second, the last one stays.
export function rowsAlong(columns: Columns, axis: XAxis): number[] {
  const along = columns[axis] ?? [];
  const rows: number[] = [];
  along.forEach((x, row) => {
    if (x === null) return;
    while (rows.length && along[rows.at(-1)!]! >= x) rows.pop();
    rows.push(row);
  });
  return rows;
}

export function points(columns: Columns, column: string, axis: XAxis, window: number): Points {
  const rows = rowsAlong(columns, axis);
  const raw = rows.map((row) => columns[column][row]);
  return { x: rows.map((row) => columns[axis][row]!), raw, y: smoothed(raw, window) };
}

// Each value's mean with those around it, `window` in all; fewer at the ends.
export function smoothed(values: (number | null)[], window: number): (number | null)[] {
  const reach = (window - 1) / 2;
  return values.map((value, row) => {
    if (value === null || window === 1) return value;
    const near = Math.min(reach, row, values.length - 1 - row); // as many before as after
    const around = values.slice(row - near, row + near + 1).filter((each) => each !== null);
    return around.reduce((sum, each) => sum + each, 0) / around.length;
  });
}

// The row that stands nearest to x; null where the run has none.
export function nearest({ x, y }: { x: ArrayLike<number>; y: ArrayLike<number | null | undefined> }, at: number): number | null {
  let best: number | null = null;
  let [first, last] = [Infinity, -Infinity];
  let gap = 0;
  for (let row = 0; row < x.length; row++) {
    if (y[row] === null || y[row] === undefined) continue;
    if (best === null || Math.abs(x[row] - at) < Math.abs(x[best] - at)) best = row;
    if (last !== -Infinity) gap = Math.max(gap, x[row] - last);
    first = Math.min(first, x[row]);
    last = x[row];
  }
  return best !== null && at >= first - gap && at <= last + gap ? best : null;
}

export function csv(names: string[], curves: Map<string, Columns>, columns: string[], axis: XAxis, window: number, view: View): string {
  const head = ["run", "env_steps", "wall_seconds", ...columns, "mean_of_rows"];
  const lines = [head.join(",")];
  for (const name of names) {
    const curve = curves.get(name)!;
    const rows = rowsAlong(curve, axis);
    const shown = columns.map((column) => points(curve, column, axis, window).y);
    rows.forEach((row, i) => {
      const x = curve[axis][row]!;
      if (x < view.min || x > view.max) return;
      const cells = [curve.env_steps[row], curve.wall_seconds[row], ...shown.map((values) => values[i]), window];
      lines.push([`"${name.replaceAll('"', '""')}"`, ...cells.map((cell) => cell ?? "")].join(","));
    });
  }
  return `${lines.join("\r\n")}\r\n`;
}

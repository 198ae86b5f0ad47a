// Where an axis has its ticks, what they are called, and in which unit.

export interface Unit {
  title: string;
  factor: number; // of the unit, in what is measured
}

// About `most` round numbers between two others.
export function niceTicks(min: number, max: number, most: number): number[] {
  if (!(max > min)) return [min];
  const least = (max - min) / Math.max(most, 1);
  const power = 10 ** Math.floor(Math.log10(least));
  const step = [1, 2, 5, 10].map((digit) => digit * power).find((each) => each >= least * (1 - 1e-9)) ?? 10 * power;
  const first = Math.ceil(min / step - 1e-9);
  const last = Math.floor(max / step + 1e-9);
  return Array.from({ length: last - first + 1 }, (_, i) => (first + i) * step);
}

// Labels with as many digits as tell each tick from the others, and from what it is not.
export function tickLabels(ticks: number[]): string[] {
  const largest = Math.max(...ticks.map(Math.abs));
  if (largest === 0) return ticks.map(() => "0");
  if (largest >= 1e7 || largest < 1e-3) {
    const exponent = Math.floor(Math.log10(largest) + 1e-9);
    const raised = [...String(exponent)].map((letter) => "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"["-0123456789".indexOf(letter)]).join("");
    return plain(ticks.map((tick) => tick / 10 ** exponent)).map((text) => (Number(text.replace("−", "-")) === 0 ? "0" : `${text}×10${raised}`));
  }
  return plain(ticks);
}

function plain(ticks: number[]): string[] {
  const gaps = ticks.slice(1).map((tick, i) => Math.abs(tick - ticks[i]));
  const gap = Math.min(...gaps.filter((each) => each > 0), Math.max(...ticks.map(Math.abs)));
  let digits = 0;
  while (digits < 15 && ticks.some((tick) => Math.abs(Number(tick.toFixed(digits)) - tick) > gap / 1000)) digits++;
  return ticks.map((tick) => number(tick, digits));
}

// With a true minus sign, and thousands apart.
export function number(value: number, digits: number): string {
  const text = Math.abs(value).toLocaleString("en", { minimumFractionDigits: digits, maximumFractionDigits: digits });
  return value < 0 && Number(value.toFixed(digits)) !== 0 ? `−${text}` : text;
}

// A value as it is read out: three significant digits, or all before the point.
export function readable(value: number): string {
  const size = Math.abs(value);
  if (size !== 0 && size < 1e-3) return tickLabels([Number(value.toPrecision(3))])[0];
  return number(value, size >= 100 ? 0 : size >= 10 ? 1 : size >= 1 ? 2 : 3);
}

export type XAxis = "env_steps" | "wall_seconds";

export function xUnit(axis: XAxis, span: number): Unit {
  if (axis === "env_steps") {
    if (span >= 2e5) return { title: "agent steps, millions", factor: 1e6 };
    return span >= 2e3 ? { title: "agent steps, thousands", factor: 1e3 } : { title: "agent steps", factor: 1 };
  }
  if (span >= 4 * 86400) return { title: "wall time, days", factor: 86400 };
  if (span >= 3 * 3600) return { title: "wall time, hours", factor: 3600 };
  return span >= 180 ? { title: "wall time, minutes", factor: 60 } : { title: "wall time, seconds", factor: 1 };
}

// A place on the x axis, in words.
export function xText(axis: XAxis, x: number): string {
  if (axis === "env_steps") return `${Math.round(x).toLocaleString("en")} agent steps`;
  const seconds = Math.round(x);
  const [hours, minutes] = [Math.floor(seconds / 3600), Math.floor(seconds / 60) % 60];
  if (hours) return `${hours} h ${minutes} min`;
  return minutes ? `${minutes} min ${seconds % 60} s` : `${seconds} s`;
}

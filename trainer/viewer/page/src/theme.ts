// Colours by role, from the style sheet, so that canvases follow light and dark.

const NAMES = [
  "learner", "learner-text", "opponent", "opponent-text", "switch", "switch-text", "back", "panel", "text", "muted", "line", "floor", "wall", "grid", "sky",
  "action-x", "action-z",
] as const;
export type Theme = Record<(typeof NAMES)[number], string> & { dark: boolean };

const dark = matchMedia("(prefers-color-scheme: dark)");

export function theme(): Theme {
  const style = getComputedStyle(document.documentElement);
  const colours = Object.fromEntries(NAMES.map((name) => [name, style.getPropertyValue(`--${name}`).trim()]));
  return { ...colours, dark: dark.matches } as Theme;
}

export function onThemeChange(callback: () => void): void {
  dark.addEventListener("change", callback);
}

// For runs laid over each other: Paul Tol's colour-blind safe "bright" scheme, without what is near orange and purple.
const RUNS = ["#4477aa", "#228833", "#ee6677", "#66ccee", "#ccbb44", "#999999"];
const DASHES = [[], [7, 4], [2, 3]];

export function runColour(index: number): string {
  return RUNS[index % RUNS.length];
}

export function runDash(index: number): number[] {
  return DASHES[Math.floor(index / RUNS.length) % DASHES.length];
}

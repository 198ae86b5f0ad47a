// Colours by role, from the style sheet, so that canvases follow light and dark.

const NAMES = [
  "learner", "opponent", "switch", "back", "panel", "text", "muted", "line", "floor", "wall", "grid", "sky",
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

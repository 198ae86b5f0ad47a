// What the page says above everything else, and how it names a run.

import { Scene, element } from "./data";

// A live region speaks when its text is set, so the same sentences are not set again.
export function say(...sentences: (string | null | undefined)[]): void {
  const notes = element("notes");
  const text = sentences.filter(Boolean).join(" ");
  if (notes.textContent !== text) notes.textContent = text;
  notes.hidden = !text;
}

export function describe(scene: Scene): string {
  const { run } = scene;
  return `${run.run_id} · ${run.algo}, c = ${run.c}, seed ${run.seed}, ${run.env === "builtin" ? "built-in player" : `player ${run.env}`}`;
}

// A run's line: a colour and a dash that follow from its name alone, so that they stay whatever else is shown.

import { make } from "./data";

export const COLOURS = 8; // --run-0 to --run-7 in learning.css
const DASHES = [[], [8, 4], [3, 3], [9, 3, 2, 3], [15, 5]];

export interface RunStyle {
  colour: string; // a property of the style sheet
  dash: number[];
}

export function runStyle(name: string): RunStyle {
  // Runs that differ in a number at the end, as seeds do, come after each other and so never look alike.
  const [, text, digits] = /^(.*?)(\d{0,9})$/s.exec(name)!;
  let hash = 0x811c9dc5; // FNV-1a
  for (const letter of text) hash = Math.imul(hash ^ letter.codePointAt(0)!, 0x01000193) >>> 0;
  const slot = (hash + Number(digits)) % (COLOURS * DASHES.length);
  return { colour: `--run-${slot % COLOURS}`, dash: DASHES[Math.floor(slot / COLOURS)] };
}

// A property's colour as canvases need it.
export function computed(colour: string): string {
  return getComputedStyle(document.documentElement).getPropertyValue(colour).trim();
}

// A piece of a run's line, for lists and tables.
export function swatch(name: string): SVGSVGElement {
  const { colour, dash } = runStyle(name);
  const svg = document.createElementNS("http://www.w3.org/2000/svg", "svg");
  svg.setAttribute("class", "swatch");
  svg.setAttribute("viewBox", "0 0 30 6");
  svg.setAttribute("aria-hidden", "true");
  const line = document.createElementNS(svg.namespaceURI!, "path");
  line.setAttribute("d", "M0 3h30");
  line.setAttribute("style", `stroke: var(${colour})`);
  line.setAttribute("stroke-dasharray", dash.join(" "));
  svg.append(line);
  return svg as SVGSVGElement;
}

export function named(name: string, shown = name): HTMLElement {
  const span = make("span", "", { className: "named" });
  span.append(swatch(name), make("span", shown));
  return span;
}

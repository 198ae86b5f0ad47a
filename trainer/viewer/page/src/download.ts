// Files that the page makes of what it shows.

import { CurveChart } from "./curvechart";
import { make } from "./data";
import { computed, runStyle } from "./runstyle";

const MARGIN = 16; // pixels on the screen, as the rest
const LINE = 20;

export function save(name: string, content: Blob): void {
  const address = URL.createObjectURL(content);
  make("a", "", { href: address, download: name }).click();
  setTimeout(() => URL.revokeObjectURL(address), 10_000);
}

// All charts in two columns, with the runs' names above.
export async function chartsPicture(charts: CurveChart[], names: string[]): Promise<Blob> {
  const drawn = charts.map((chart) => ({ chart, canvas: chart.plot!.ctx.canvas }));
  const scale = devicePixelRatio || 1;
  const wide = Math.max(...drawn.map(({ canvas }) => canvas.width)) / scale;
  const high = Math.max(...drawn.map(({ canvas }) => canvas.height)) / scale + LINE;
  const picture = document.createElement("canvas");
  const g = picture.getContext("2d")!;
  const font = (weight: string) => `${weight} 13px system-ui, "Segoe UI", Roboto, "DejaVu Sans", sans-serif`;
  g.font = font("400");
  const width = 2 * wide + 3 * MARGIN;
  const places: { name: string; x: number; y: number }[] = [];
  let [x, y] = [MARGIN, MARGIN];
  for (const name of names) {
    const room = 40 + g.measureText(name).width + MARGIN;
    if (x > MARGIN && x + room > width) [x, y] = [MARGIN, y + LINE];
    places.push({ name, x, y });
    x += room;
  }
  const top = y + LINE + MARGIN / 2;
  picture.width = Math.round(width * scale);
  picture.height = Math.round((top + Math.ceil(drawn.length / 2) * (high + MARGIN)) * scale);
  g.scale(scale, scale);
  g.fillStyle = computed("--panel");
  g.fillRect(0, 0, picture.width, picture.height);
  g.textBaseline = "middle";
  for (const place of places) {
    const { colour, dash } = runStyle(place.name);
    g.strokeStyle = computed(colour);
    g.lineWidth = 2;
    g.setLineDash(dash);
    g.beginPath();
    g.moveTo(place.x, place.y + LINE / 2);
    g.lineTo(place.x + 30, place.y + LINE / 2);
    g.stroke();
    g.font = font("400");
    g.fillStyle = computed("--text");
    g.fillText(place.name, place.x + 37, place.y + LINE / 2);
  }
  drawn.forEach(({ chart, canvas }, i) => {
    const [left, above] = [MARGIN + (i % 2) * (wide + MARGIN), top + Math.floor(i / 2) * (high + MARGIN)];
    g.font = font("600");
    g.fillText(chart.measure.title, left, above + LINE / 2);
    g.drawImage(canvas, left, above + LINE, canvas.width / scale, canvas.height / scale);
  });
  return new Promise((done, fail) => picture.toBlob((blob) => (blob ? done(blob) : fail(new Error("This browser can't make a PNG of this size."))), "image/png"));
}

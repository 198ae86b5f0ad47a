// One measure of several runs against steps or time, drawn by uPlot, with a cursor that mouse and keys move.

import uPlot from "uplot";
import { XAxis, niceTicks, number, readable, tickLabels, xText, xUnit } from "./axes";
import { Points, View, nearest } from "./curves";
import { make } from "./data";
import { computed, named, runStyle } from "./runstyle";

const HEIGHT = 236;
const FONT = '12px system-ui, "Segoe UI", Roboto, "DejaVu Sans", sans-serif';
const TICKS_APART = 30; // pixels, of the y axis
const LETTER = 7; // pixels, at most on average
const IN_TIP = 12; // runs

export interface Measure {
  column: string; // of progress.csv
  title: string;
  unit: string; // the y axis
  evaluated?: string; // the evaluation's name of the same
  range?: [number, number];
}

export interface Curve extends Points {
  name: string;
  mark: { x: number; y: number } | null; // what the evaluation gave
}

export interface Drawn {
  curves: Curve[];
  axis: XAxis;
  view: View;
  smooth: boolean;
  emphasised: string | null;
  dark: boolean;
}

export class CurveChart {
  onCursor: (x: number | null) => void = () => {};
  onZoom: (view: View | null) => void = () => {};
  plot: uPlot | null = null;
  private drawn: Drawn | null = null;
  private shape = "";
  private cursor: number | null = null;
  private tipped = false;
  private following = false;
  private readonly note = make("span", "", { className: "note" });
  private readonly holder = make("div");
  private readonly tip = make("div", "", { className: "tip", hidden: true });

  constructor(readonly home: HTMLElement, readonly measure: Measure) {
    const title = make("h3");
    const id = `curve-${measure.column}`;
    title.append(make("b", measure.title, { id }), this.note);
    home.className = "chart curve";
    home.tabIndex = 0;
    home.dataset.column = measure.column;
    home.setAttribute("role", "application");
    home.setAttribute("aria-roledescription", "chart");
    home.setAttribute("aria-labelledby", id);
    home.setAttribute("aria-describedby", "curve-help");
    this.tip.setAttribute("aria-hidden", "true");
    home.append(title, this.holder, this.tip);
    new ResizeObserver(() => this.fit()).observe(home);
  }

  draw(drawn: Drawn, note: string): void {
    const shape = JSON.stringify([drawn.curves.map((curve) => curve.name), drawn.axis, drawn.smooth, drawn.dark]);
    this.drawn = drawn;
    if (this.note.textContent !== note) this.note.textContent = note;
    const kept = this.plot && shape === this.shape;
    if (!kept) this.build();
    this.shape = shape;
    const { view, emphasised } = drawn;
    this.following = true; // a cursor that stays where it was on the screen is nobody's wish
    this.plot!.batch((plot: uPlot) => {
      if (kept) plot.setData(this.data(), false);
      plot.series.forEach((series, i) => {
        if (i > 0 && i <= drawn.curves.length) series.width = drawn.curves[i - 1].name === emphasised ? 3.4 : 1.8;
      });
      plot.setScale("x", view);
    });
    this.following = false;
    this.moveCursor(this.cursor, this.tipped);
  }

  // Where the cursor stands; with `tip`, with the values there.
  moveCursor(x: number | null, tip: boolean): void {
    this.cursor = x;
    this.tipped = tip;
    const { plot, drawn } = this;
    if (!plot || !drawn) return;
    const seen = x !== null && x >= drawn.view.min && x <= drawn.view.max;
    this.following = true;
    plot.setCursor(seen ? { left: plot.valToPos(x, "x"), top: 0 } : { left: -10, top: -10 });
    this.following = false;
    if (tip && seen) this.showTip(x);
    else this.tip.hidden = true;
  }

  // Every run's value nearest to a place, as shown.
  values(at: number): { name: string; value: number | null }[] {
    return (this.drawn?.curves ?? []).map((curve) => {
      const row = nearest(curve, at);
      return { name: curve.name, value: row === null ? null : curve.y[row] };
    });
  }

  // What the axes say now.
  get labels(): { x: string[]; y: string[]; titles: string[] } {
    const axes = this.plot!.axes as unknown as { _values: string[]; label: string | (() => string) }[];
    const titles = axes.map(({ label }) => (typeof label === "function" ? label() : label));
    return { x: axes[0]._values, y: axes[1]._values, titles };
  }

  private data(): uPlot.AlignedData {
    const { curves, smooth } = this.drawn!;
    if (!curves.length) return [[0, 1], [null, null]];
    const lines = [...curves.map(({ x, y }) => [x, y]), ...(smooth ? curves.map(({ x, raw }) => [x, raw]) : [])];
    return uPlot.join(lines as uPlot.AlignedData[]);
  }

  private build(): void {
    const { curves, axis, smooth } = this.drawn!;
    const text = computed("--muted");
    const common: Partial<uPlot.Axis> = {
      stroke: text, font: FONT, labelFont: FONT, labelSize: 18, labelGap: 0, ticks: { show: false },
      grid: { stroke: computed("--line"), width: 1 },
    };
    const unit = () => xUnit(axis, this.drawn!.view.max - this.drawn!.view.min);
    const line = (curve: Curve, raw: boolean): uPlot.Series => {
      const { colour, dash } = runStyle(curve.name);
      return {
        label: curve.name, stroke: computed(colour) + (raw ? "59" : ""), width: raw ? 1 : 1.8,
        dash: raw ? undefined : dash, points: { show: false }, spanGaps: true,
      };
    };
    this.plot?.destroy();
    this.plot = new uPlot(
      {
        width: Math.max(this.holder.clientWidth, 50),
        height: HEIGHT,
        padding: [8, 14, 0, 0],
        scales: { x: { time: false }, y: { range: (_, min, max) => this.yRange(min, max) } },
        legend: { show: false },
        cursor: {
          y: false,
          drag: { x: true, y: false, setScale: false },
          points: { size: 7 },
          dataIdx: (plot, series, index, at) => (series > curves.length ? null! : series === 0 ? index : nearest({ x: plot.data[0], y: plot.data[series] }, at)!),
          bind: { dblclick: () => () => (this.onZoom(null), null) },
        },
        axes: [
          {
            ...common, size: 24, gap: 5,
            label: () => unit().title,
            splits: (plot, _, min, max) => xTicks(min, max, unit().factor, plot.width - 70),
            values: (_, ticks) => tickLabels(ticks.map((tick) => tick / unit().factor)),
          },
          {
            ...common, gap: 5,
            label: this.measure.unit,
            size: (_, labels) => 12 + LETTER * Math.max(3, ...(labels ?? []).map((each) => each.length)),
            splits: (_, __, min, max) => niceTicks(min, max, (HEIGHT - 50) / TICKS_APART),
            values: (_, ticks) => tickLabels(ticks),
          },
        ],
        series: [{}, ...(curves.length ? [...curves.map((curve) => line(curve, false)), ...(smooth ? curves.map((curve) => line(curve, true)) : [])] : [{}])],
        hooks: {
          setCursor: [(plot) => this.followMouse(plot)],
          setSelect: [(plot) => this.zoom(plot)],
          draw: [(plot) => this.drawMarks(plot)],
        },
      },
      this.data(),
      this.holder,
    );
    // A finger does not move before it taps, and uPlot follows only what moves.
    const { over } = this.plot;
    over.addEventListener("click", (event) => this.onCursor(this.plot!.posToVal(event.clientX - over.getBoundingClientRect().left, "x")));
  }

  private yRange(min: number | null, max: number | null): [number, number] {
    const { range } = this.measure;
    if (range) return range;
    const { curves, view } = this.drawn!;
    const marks = curves.flatMap(({ mark }) => (mark && mark.x >= view.min && mark.x <= view.max ? [mark.y] : []));
    const known = [min, max, ...marks].filter((each) => each !== null && Number.isFinite(each)) as number[];
    if (!known.length) return [0, 1];
    const [low, high] = [Math.min(...known), Math.max(...known)];
    const margin = high > low ? 0.08 * (high - low) : Math.abs(high) / 10 || 1;
    return [low >= 0 ? Math.max(low - margin, 0) : low - margin, high + margin];
  }

  private followMouse(plot: uPlot): void {
    if (this.following) return;
    const { left } = plot.cursor;
    this.onCursor(left !== undefined && left >= 0 ? plot.posToVal(left, "x") : null);
  }

  private zoom(plot: uPlot): void {
    const { left, width } = plot.select;
    if (width <= 0) return;
    plot.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
    if (width > 4) this.onZoom({ min: plot.posToVal(left, "x"), max: plot.posToVal(left + width, "x") });
  }

  // The evaluation's results, each a diamond at its policy's age.
  private drawMarks(plot: uPlot): void {
    const g = plot.ctx;
    const { left, top, width, height } = plot.bbox;
    g.save();
    g.beginPath();
    g.rect(left - 12, top - 12, width + 24, height + 24);
    g.clip();
    g.setLineDash([]);
    for (const { name, mark } of this.drawn!.curves) {
      if (!mark) continue;
      const [x, y] = [plot.valToPos(mark.x, "x", true), plot.valToPos(mark.y, "y", true)];
      if (x < left - 1 || x > left + width + 1) continue;
      const size = 6 * uPlot.pxRatio;
      g.beginPath();
      g.moveTo(x, y - size);
      for (const [dx, dy] of [[size, 0], [0, size], [-size, 0]]) g.lineTo(x + dx, y + dy);
      g.closePath();
      g.fillStyle = computed(runStyle(name).colour);
      g.strokeStyle = computed("--panel");
      g.lineWidth = 1.5 * uPlot.pxRatio;
      g.fill();
      g.stroke();
    }
    g.restore();
  }

  private showTip(x: number): void {
    const { plot, tip } = this;
    const { axis } = this.drawn!;
    const known = this.values(x).filter(({ value }) => value !== null);
    const rows = known.slice(0, IN_TIP).map(({ name, value }) => {
      const row = make("div");
      row.append(named(name), make("b", readable(value!)));
      return row;
    });
    const more = known.length > IN_TIP ? [make("div", `and ${number(known.length - IN_TIP, 0)} more`)] : [];
    tip.replaceChildren(make("p", xText(axis, x)), ...rows, ...more);
    tip.hidden = !known.length;
    const over = plot!.over.getBoundingClientRect();
    const home = this.home.getBoundingClientRect();
    const at = over.left - home.left + plot!.valToPos(x, "x");
    // Below the lines, which it must not hide.
    tip.style.left = `${Math.min(Math.max(at - tip.offsetWidth / 2, 4), home.width - tip.offsetWidth - 4)}px`;
    tip.style.top = `${over.bottom - home.top + 4}px`;
  }

  private fit(): void {
    const width = this.holder.clientWidth;
    if (!this.plot || width <= 0 || width === this.plot.width) return;
    this.plot.setSize({ width, height: HEIGHT });
    this.moveCursor(this.cursor, this.tipped);
  }
}

// Round in the axis's unit, and as many as their labels leave room for.
function xTicks(min: number, max: number, factor: number, width: number): number[] {
  for (let most = 8; most > 1; most--) {
    const ticks = niceTicks(min / factor, max / factor, most);
    const longest = Math.max(...tickLabels(ticks).map((label) => label.length));
    if (ticks.length * (LETTER * longest + 14) <= width) return ticks.map((tick) => tick * factor);
  }
  return niceTicks(min / factor, max / factor, 1).map((tick) => tick * factor);
}

// An episode's charts over time, drawn by uPlot.

import uPlot from "uplot";
import { tickLabels } from "./axes";
import { make } from "./data";
import { Theme } from "./theme";

export interface Line {
  label: string;
  colour: string;
  values: ArrayLike<number | null>;
  stepped?: boolean;
  width?: number;
  dash?: number[];
}

export interface ChartOptions {
  height: number;
  range?: [number, number];
  fromZero?: boolean;
  x: (value: number) => string; // an x axis label
  levels?: { value: number; colour: string; fillBelow?: boolean }[];
  onSeek?: (x: number) => void;
}

export class Chart {
  private plot: uPlot | null = null;
  private readonly head = make("div", "", { className: "head" });
  private readonly observer: ResizeObserver;
  private readonly holder = make("div");
  private readonly labels = make("h3");
  private at: number | null = null;

  constructor(readonly home: HTMLElement, private readonly options: ChartOptions) {
    home.classList.add("chart");
    home.append(this.labels, this.holder);
    this.observer = new ResizeObserver(() => this.fit());
    this.observer.observe(home);
  }

  // labels: what stands above the chart, as nodes.
  show(x: ArrayLike<number>, lines: Line[], theme: Theme, labels: (Node | string)[]): void {
    this.labels.replaceChildren(...labels);
    const data = [x, ...lines.map((line) => line.values)] as unknown as uPlot.AlignedData;
    const { options } = this;
    const axis: Partial<uPlot.Axis> = {
      stroke: theme.muted,
      grid: { stroke: theme.line, width: 1 },
      ticks: { show: false },
      font: '11px system-ui, "Segoe UI", Roboto, "DejaVu Sans", sans-serif',
    };
    this.plot?.destroy();
    this.plot = new uPlot(
      {
        width: Math.max(this.holder.clientWidth, 50),
        height: options.height,
        padding: [6, 24, 0, 0],
        scales: { x: { time: false }, y: { range: options.range ? () => options.range! : options.fromZero ? (_, __, max) => [0, 1.08 * Math.max(max, 0.3)] : (_, min, max) => (min == null ? [-1, 1] : uPlot.rangeNum(min, max, 0.1, true)) } },
        legend: { show: false },
        cursor: { drag: { x: false, y: false }, points: { show: !options.onSeek }, y: false, x: true },
        axes: [
          { ...axis, size: 24, gap: 6, values: (_, ticks) => ticks.map(options.x) },
          { ...axis, size: 44, gap: 4, values: (_, ticks) => tickLabels(ticks), space: 26 },
        ],
        series: [
          {},
          ...lines.map((line) => ({
            label: line.label,
            stroke: line.colour,
            width: line.width ?? 1.6,
            dash: line.dash,
            points: { show: false },
            spanGaps: true,
            paths: line.stepped ? uPlot.paths.stepped!({ align: -1 }) : undefined,
          })),
        ],
        hooks: { drawClear: [(plot) => this.drawLevels(plot)] },
      },
      data,
      this.holder,
    );
    this.plot.over.append(this.head);
    this.head.hidden = !options.onSeek;
    if (options.onSeek) {
      const seek = (event: PointerEvent) => {
        if (event.buttons & 1 && this.plot) {
          const left = event.clientX - this.plot.over.getBoundingClientRect().left;
          options.onSeek!(this.plot.posToVal(left, "x"));
        }
      };
      this.plot.over.addEventListener("pointerdown", seek);
      this.plot.over.addEventListener("pointermove", seek);
    }
    if (this.at !== null) this.moveHead(this.at);
  }

  moveHead(x: number): void {
    this.at = x;
    if (this.plot) this.head.style.transform = `translateX(${this.plot.valToPos(x, "x")}px)`;
  }

  private fit(): void {
    const width = this.holder.clientWidth;
    if (this.plot && width > 0 && width !== this.plot.width) {
      this.plot.setSize({ width, height: this.options.height });
      if (this.at !== null) this.moveHead(this.at);
    }
  }

  private drawLevels(plot: uPlot): void {
    const g = plot.ctx;
    const { left, top, width, height } = plot.bbox;
    for (const { value, colour, fillBelow } of this.options.levels ?? []) {
      const y = plot.valToPos(value, "y", true);
      if (!(y >= top && y <= top + height)) continue;
      g.save();
      g.strokeStyle = g.fillStyle = colour;
      if (fillBelow) {
        g.globalAlpha = 0.13;
        g.fillRect(left, y, width, top + height - y);
        g.globalAlpha = 1;
      }
      g.setLineDash([4, 3]);
      g.beginPath();
      g.moveTo(left, y);
      g.lineTo(left + width, y);
      g.stroke();
      g.restore();
    }
  }
}

export function key(text: string, colour: string, dash: number[] = []): HTMLElement {
  const span = make("span");
  const mark = make("i");
  mark.style.borderColor = colour;
  mark.style.borderTopStyle = dash.length ? "dashed" : "solid";
  span.append(mark, text);
  return span;
}

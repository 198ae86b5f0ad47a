// Learning curves of one or several runs, which follow the runs' files, and the runs beside each other.

import { XAxis, niceTicks, readable, tickLabels, xText, xUnit } from "./axes";
import { Curve, CurveChart, Measure } from "./curvechart";
import { Columns, View, csv, points } from "./curves";
import { element, make } from "./data";
import { chartsPicture, save } from "./download";
import "./learning.css";
import { RunList, RunState } from "./runlist";
import { RunTables } from "./runtables";
import { onThemeChange, theme } from "./theme";

export type { RunState } from "./runlist";
export type Curves = Columns;

// What corridor watch answers when it is asked for runs.
export interface Overview {
  runs: RunState[];
  curves: Record<string, Columns>;
  settings: Record<string, Record<string, string>>;
  unlisted: number;
}

const MEASURES: Measure[] = [
  { column: "mean_return", title: "Extrinsic return", unit: "mean of 100 episodes", evaluated: "mean_return" },
  { column: "success_rate", title: "Success rate", unit: "share of 100 episodes", evaluated: "success_rate", range: [-0.03, 1.03] },
  { column: "mean_episode_length", title: "Episode length", unit: "decisions", evaluated: "mean_episode_length" },
  { column: "intrinsic_reward", title: "Intrinsic reward", unit: "mean per agent step" },
  { column: "steps_per_second", title: "Speed", unit: "agent steps per second" },
];
const ZOOM = 2;
const DEEPEST = 1000; // times
const QUIET_MILLISECONDS = 500; // after the last key, before the values are said

export class Learning {
  readonly chosen = new Set<string>();
  readonly charts: CurveChart[];
  onChoice: () => void = () => {};
  private readonly list = new RunList(this.chosen);
  private readonly tables = new RunTables();
  private readonly axisChoice = element<HTMLSelectElement>("x-axis");
  private readonly smoothing = element<HTMLSelectElement>("smoothing");
  private readonly runs = new Map<string, RunState>();
  private readonly curves = new Map<string, Columns>();
  private readonly settings = new Map<string, Record<string, string>>();
  private readonly news = new Map<string, string>(); // of the curves and settings that are here
  private emphasised: string | null = null;
  private view: View | null = null; // null: everything, also what is still to come
  private cursor: number | null = null;
  private saying = 0;

  constructor() {
    Object.assign(((window as any).corridor ??= {}), { learning: this, axes: { niceTicks, tickLabels, xUnit } });
    this.charts = MEASURES.map((measure) => {
      const box = make("div");
      element("curves").append(box);
      const chart = new CurveChart(box, measure);
      chart.onCursor = (x) => this.moveCursor(x, chart);
      chart.onZoom = (view) => this.show(view);
      box.addEventListener("keydown", (event) => this.key(event, chart));
      box.addEventListener("blur", () => this.moveCursor(null, chart));
      return chart;
    });
    this.list.onChoice = () => {
      this.draw();
      this.onChoice();
    };
    this.list.onEmphasis = (name) => {
      this.emphasised = name;
      this.draw();
    };
    this.axisChoice.addEventListener("change", () => {
      this.cursor = null;
      this.show(null);
    });
    this.smoothing.addEventListener("change", () => this.draw());
    for (const button of element("curve-tools").querySelectorAll("button"))
      button.addEventListener("click", () => this.use(button.dataset.does!));
    onThemeChange(() => this.draw());
  }

  // Chosen runs of which there is something new.
  get wanted(): string[] {
    return [...this.chosen].filter((name) => {
      const run = this.runs.get(name);
      return run && run.status !== "gone" && run.news !== this.news.get(name);
    });
  }

  // Takes up an answer; `runs` are all that were ever seen.
  update(runs: RunState[], answer: Overview): void {
    const evaluations = () => JSON.stringify([...this.chosen].map((name) => this.runs.get(name)?.evaluation));
    const before = evaluations();
    for (const run of runs) this.runs.set(run.name, run);
    for (const run of answer.runs) {
      if (!(run.name in answer.curves)) continue;
      this.curves.set(run.name, answer.curves[run.name]);
      this.settings.set(run.name, answer.settings[run.name]);
      this.news.set(run.name, run.news);
    }
    this.list.update(runs, answer.unlisted);
    this.draw(Object.keys(answer.curves).length > 0 || evaluations() !== before);
  }

  // Draws tables, and charts if they have something new.
  draw(charts = true): void {
    if (element("learning").hidden) return;
    this.tables.update(
      [...this.chosen].map((name) => ({
        name,
        evaluation: this.runs.get(name)?.evaluation ?? null,
        settings: this.settings.get(name) ?? null,
      })),
    );
    if (!charts && this.charts[0].plot) return;
    const names = this.names;
    const { axis, window } = this;
    const { dark } = theme();
    for (const chart of this.charts) {
      const curves = names.map((name) => this.curve(name, chart.measure)).filter((curve) => curve.y.some((y) => y !== null));
      const note = curves.length ? "" : names.length ? "none" : "nothing yet";
      chart.draw({ curves, axis, view: this.shownView, smooth: window > 1, emphasised: this.emphasised, dark }, note);
    }
  }

  private get names(): string[] {
    return [...this.runs.keys()].filter((name) => this.chosen.has(name) && this.curves.get(name)?.env_steps.length);
  }

  private get axis(): XAxis {
    return this.axisChoice.value as XAxis;
  }

  private get window(): number {
    return Number(this.smoothing.value);
  }

  private curve(name: string, { column, evaluated }: Measure): Curve {
    const evaluation = this.runs.get(name)?.evaluation;
    const [x, y] = [evaluation?.[this.axis], evaluated && evaluation?.[evaluated]];
    const mark = typeof x === "number" && typeof y === "number" ? { x, y } : null;
    return { name, mark, ...points(this.curves.get(name)!, column, this.axis, this.window) };
  }

  // Everything there is along the axis.
  private get whole(): View {
    const ends = this.names.flatMap((name) => {
      const along = this.curves.get(name)![this.axis].filter((x) => x !== null);
      const evaluated = this.runs.get(name)?.evaluation?.[this.axis];
      return [Math.max(0, ...along), ...(typeof evaluated === "number" ? [evaluated] : [])];
    });
    return { min: 0, max: Math.max(0, ...ends) || 1 };
  }

  private get shownView(): View {
    return this.view ?? this.whole;
  }

  private show(view: View | null): void {
    const { whole } = this;
    if (view) {
      const span = Math.min(Math.max(view.max - view.min, whole.max / DEEPEST), whole.max);
      const middle = (view.min + view.max) / 2;
      const min = Math.min(Math.max(middle - span / 2, 0), whole.max - span);
      view = span < whole.max ? { min, max: min + span } : null;
    }
    this.view = view;
    this.draw();
  }

  private zoom(by: number): void {
    const { min, max } = this.shownView;
    const seen = this.cursor !== null && this.cursor >= min && this.cursor <= max;
    const around = seen ? this.cursor! : (min + max) / 2;
    this.show({ min: around - (around - min) / by, max: around + (max - around) / by });
  }

  private pan(share: number): void {
    const { min, max } = this.shownView;
    const by = share * (max - min);
    if (this.view) this.show({ min: min + by, max: max + by });
  }

  private moveCursor(x: number | null, at: CurveChart): void {
    this.cursor = x;
    for (const chart of this.charts) chart.moveCursor(x, chart === at);
  }

  private key(event: KeyboardEvent, chart: CurveChart): void {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const by = event.shiftKey ? 10 : 1;
    const actions: Record<string, () => void> = {
      ArrowRight: () => this.step(by, chart),
      ArrowLeft: () => this.step(-by, chart),
      Home: () => this.step(-Infinity, chart),
      End: () => this.step(Infinity, chart),
      "+": () => this.use("in"),
      "=": () => this.use("in"),
      "-": () => this.use("out"),
      "0": () => this.use("all"),
      Escape: () => this.moveCursor(null, chart),
    };
    if (!(event.key in actions)) return;
    event.preventDefault();
    event.stopPropagation();
    actions[event.key]();
    if (this.cursor !== null) this.say(chart);
  }

  // Moves the cursor over the places where a run has a value, and the view with it.
  private step(by: number, chart: CurveChart): void {
    const along = chart.plot!.data[0] as number[];
    if (!along.length) return;
    const { min, max } = this.shownView;
    let next: number;
    if (this.cursor === null && Number.isFinite(by)) {
      next = along.findIndex((x) => x >= min);
    } else {
      const at = this.cursor ?? 0;
      const here = along.reduce((best, x, i) => (Math.abs(x - at) < Math.abs(along[best] - at) ? i : best), 0);
      next = Math.min(Math.max(here + by, 0), along.length - 1);
    }
    const x = along[Math.max(next, 0)];
    if (this.view && (x < min || x > max)) this.show({ min: x - (max - min) / 2, max: x + (max - min) / 2 });
    this.moveCursor(x, chart);
  }

  // Says the values at the cursor, once the keys are quiet.
  private say(chart: CurveChart): void {
    clearTimeout(this.saying);
    this.saying = window.setTimeout(() => {
      if (this.cursor === null) return;
      const values = chart.values(this.cursor).map(({ name, value }) => `${name} ${value === null ? "no value" : readable(value)}`);
      element("curve-values").textContent = `${chart.measure.title} at ${xText(this.axis, this.cursor)}: ${values.join(", ") || "nothing"}.`;
    }, QUIET_MILLISECONDS);
  }

  private use(what: string): void {
    const actions: Record<string, () => void> = {
      in: () => this.zoom(ZOOM),
      out: () => this.zoom(1 / ZOOM),
      all: () => this.show(null),
      back: () => this.pan(-0.5),
      on: () => this.pan(0.5),
      csv: () => {
        const columns = MEASURES.map(({ column }) => column);
        const text = csv(this.names, this.curves, columns, this.axis, this.window, this.shownView);
        save("learning-curves.csv", new Blob([text], { type: "text/csv" }));
      },
      png: () => void chartsPicture(this.charts, this.names).then((picture) => save("learning-curves.png", picture)),
    };
    actions[what]();
  }
}

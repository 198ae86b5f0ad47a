// Learning curves of one or several runs, which follow the runs' files.

import uPlot from "uplot";
import { Chart, key } from "./charts";
import { element, make } from "./data";
import { onThemeChange, runColour, runDash, theme } from "./theme";

export interface RunState {
  name: string;
  status: string; // a sentence's part: "training", "finished", ...
  env_steps: number | null;
  steps: number | null;
  c: number | null;
  seed: number | null;
  success_rate: number | null;
  steps_per_second: number | null;
  scene: string | null; // changes when there is another evaluation to show
  problem: string | null;
}

export type Curves = Record<string, (number | null)[]>;

const PANELS: [string, string, [number, number] | undefined][] = [
  ["mean_return", "extrinsic return", undefined],
  ["success_rate", "success rate", [-0.03, 1.03]],
  ["mean_episode_length", "episode length, decisions", undefined],
  ["intrinsic_reward", "intrinsic reward per step", undefined],
  ["steps_per_second", "agent steps per second", undefined],
];

export class Learning {
  readonly chosen = new Set<string>();
  onChoice: () => void = () => {};
  private readonly charts: Chart[];
  private readonly order: string[] = []; // a run keeps its colour
  private curves = new Map<string, Curves>();
  private runs: RunState[] = [];

  constructor() {
    this.charts = PANELS.map(([, , range]) => {
      const box = make("div");
      element("curves").append(box);
      return new Chart(box, { height: 190, range, x: (steps) => (steps >= 1e6 ? `${+(steps / 1e6).toFixed(2)}M` : `${Math.round(steps / 1e3)}k`) });
    });
    onThemeChange(() => this.draw());
  }

  update(runs: RunState[], curves: Map<string, Curves>): void {
    this.runs = runs;
    for (const run of runs) if (!this.order.includes(run.name)) this.order.push(run.name);
    this.curves = curves;
    this.list();
    this.draw();
  }

  colour(name: string): string {
    return runColour(Math.max(this.order.indexOf(name), 0));
  }

  private list(): void {
    element("runs").replaceChildren(
      ...this.runs.map((run) => {
        const label = make("label");
        const box = make("input", "", { type: "checkbox", checked: this.chosen.has(run.name) });
        box.style.setProperty("--run", this.colour(run.name));
        box.dataset.run = run.name;
        box.addEventListener("change", () => {
          if (box.checked) this.chosen.add(run.name);
          else this.chosen.delete(run.name);
          this.onChoice();
        });
        const facts = [
          run.env_steps === null ? null : `${run.env_steps.toLocaleString("en")} steps`,
          run.success_rate === null ? null : `success ${Math.round(100 * run.success_rate)}%`,
          run.steps_per_second === null ? null : `${Math.round(run.steps_per_second).toLocaleString("en")} steps/s`,
          run.c === null ? null : `c ${run.c}`,
          run.seed === null ? null : `seed ${run.seed}`,
          run.problem,
        ];
        label.append(box, key(run.name, this.colour(run.name), runDash(this.order.indexOf(run.name))), make("span", run.status, { className: "muted" }), make("small", facts.filter(Boolean).join(" · ")));
        const item = make("li");
        item.append(label);
        return item;
      }),
    );
  }

  private draw(): void {
    if (element("learning").hidden) return;
    const colours = theme();
    const names = this.order.filter((name) => this.chosen.has(name) && this.curves.get(name)?.env_steps.length);
    PANELS.forEach(([column, title], panel) => {
      const present = names.filter((name) => this.curves.get(name)![column].some((value) => value !== null));
      const style = (name: string) => ({ colour: this.colour(name), dash: runDash(this.order.indexOf(name)) });
      const head = [make("b", title), ...(present.length ? [] : [names.length ? "none" : "nothing yet"])];
      const tables = present.map((name) => {
        const curve = this.curves.get(name)!;
        return [curve.env_steps as number[], curve[column]] as uPlot.AlignedData;
      });
      const joined = tables.length ? uPlot.join(tables) : [[0, 1], [null, null]];
      const lines = present.map((name, i) => ({ label: name, values: joined[i + 1] as (number | null)[], ...style(name) }));
      this.charts[panel].show(joined[0] as number[], lines, colours, head);
    });
  }
}

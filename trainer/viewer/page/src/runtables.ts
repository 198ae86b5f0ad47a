// The ticked runs beside each other: what their evaluations gave, and their settings.

import { element, make } from "./data";
import { named } from "./runstyle";
import { Cell, EVALUATION, Numbers, dataTable, evaluationCells, scrolling } from "./tables";

export interface Compared {
  name: string;
  evaluation: Numbers | null;
  settings: Record<string, string> | null;
}

export class RunTables {
  private readonly only = element<HTMLInputElement>("only-differences");
  private runs: Compared[] = [];
  private shown = "";

  constructor() {
    this.only.addEventListener("change", () => this.draw());
  }

  // Draws only what has changed: a table that somebody reads stays where it is.
  update(runs: Compared[]): void {
    const wanted = JSON.stringify(runs);
    if (wanted === this.shown) return;
    this.shown = wanted;
    this.runs = runs;
    this.draw();
  }

  private draw(): void {
    element("evaluations").replaceChildren(this.evaluations());
    element("settings").replaceChildren(this.settings());
  }

  private evaluations(): HTMLElement {
    if (!this.runs.length) return make("p", "No run is ticked.", { className: "muted" });
    const head = ["run", ...EVALUATION.map(([, title]) => title), "episodes", "policy after, agent steps"];
    const rows = this.runs.map(({ name, evaluation }): Cell[] => {
      if (!evaluation) return [named(name), "not evaluated yet", ...head.slice(2).map(() => "")];
      const rest = [evaluation.episodes, evaluation.env_steps].map((value) => value?.toLocaleString("en") ?? "not reported");
      return [named(name), ...evaluationCells(evaluation), ...rest];
    });
    const table = dataTable("Evaluations of the ticked runs", head, rows);
    table.classList.add("blocks");
    return scrolling(table, "Evaluations of the ticked runs");
  }

  private settings(): HTMLElement {
    const runs = this.runs.filter(({ settings }) => settings);
    if (!runs.length) return make("p", this.runs.length ? "Not read yet." : "No run is ticked.", { className: "muted" });
    const names = [...new Set(runs.flatMap(({ settings }) => Object.keys(settings!)))];
    const differ = (name: string) => new Set(runs.map(({ settings }) => settings![name])).size > 1;
    const kept = this.only.checked && runs.length > 1 ? names.filter(differ) : names;
    if (!kept.length) return make("p", "The ticked runs have the same settings.", { className: "muted" });
    const rows = kept.map((name): Cell[] => {
      const title = make("span", name, { className: differ(name) ? "differs" : "" });
      return [title, ...runs.map(({ settings }) => settings![name] ?? "not there")];
    });
    const table = dataTable("Settings of the ticked runs", ["setting", ...runs.map(({ name }) => named(name))], rows);
    return scrolling(table, "Settings of the ticked runs");
  }
}

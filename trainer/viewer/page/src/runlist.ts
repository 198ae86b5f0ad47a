// The list of runs beside the curves, by study; rows stay in place while their runs go on.

import { element, make } from "./data";
import { named } from "./runstyle";

export interface RunState {
  name: string; // a study's runs have its name before theirs
  news: string; // changes when its curves or settings do
  status: string; // a sentence's part: "training", "finished", ...
  env_steps: number | null;
  steps: number | null;
  c: number | null;
  seed: number | null;
  success_rate: number | null;
  steps_per_second: number | null;
  evaluation: Record<string, number | null> | null;
  scene: string | null; // changes when there is another evaluation to show
  problem: string | null;
}

export class RunList {
  onChoice: () => void = () => {};
  onEmphasis: (name: string | null) => void = () => {};
  private readonly home = element("runs");
  private readonly lists = new Map<string, HTMLElement>();
  private readonly rows = new Map<string, { box: HTMLInputElement; status: HTMLElement; facts: HTMLElement }>();

  constructor(private readonly chosen: Set<string>) {}

  update(runs: RunState[], unlisted: number): void {
    for (const run of runs) {
      const row = this.rows.get(run.name) ?? this.add(run.name);
      row.box.checked = this.chosen.has(run.name);
      put(row.status, run.status);
      put(row.facts, [
        run.env_steps === null ? null : `${run.env_steps.toLocaleString("en")} steps`,
        run.success_rate === null ? null : `success ${percent(run.success_rate)}`,
        run.steps_per_second === null ? null : `${Math.round(run.steps_per_second).toLocaleString("en")} steps/s`,
        run.c === null ? null : `c\u00a0${run.c}`,
        run.seed === null ? null : `seed\u00a0${run.seed}`,
        run.evaluation && evaluated(run.evaluation),
        run.problem,
      ].filter(Boolean).join(" · "));
    }
    put(element("unlisted"), unlisted ? `${unlisted.toLocaleString("en")} more with older news are not listed; watch their study's own folder.` : "");
  }

  private add(name: string) {
    const cut = name.lastIndexOf("/");
    const label = make("label");
    const box = make("input", "", { type: "checkbox" });
    box.dataset.run = name;
    const status = make("span", "", { className: "muted" });
    const facts = make("small");
    label.append(box, named(name, name.slice(cut + 1)), status, facts);
    const item = make("li");
    item.append(label);
    box.addEventListener("change", () => {
      if (box.checked) this.chosen.add(name);
      else this.chosen.delete(name);
      this.onChoice();
    });
    item.addEventListener("pointerenter", () => this.onEmphasis(name));
    item.addEventListener("pointerleave", () => this.onEmphasis(null));
    box.addEventListener("focus", () => this.onEmphasis(name));
    box.addEventListener("blur", () => this.onEmphasis(null));
    this.list(name.slice(0, Math.max(cut, 0))).append(item);
    const row = { box, status, facts };
    this.rows.set(name, row);
    return row;
  }

  // Of a study, or of the runs that are in none.
  private list(study: string): HTMLElement {
    let list = this.lists.get(study);
    if (!list) {
      list = make("ul", "", { className: "list" });
      const group = make("section");
      if (study) group.append(make("h3", study));
      group.append(list);
      if (study) this.home.append(group);
      else this.home.prepend(group);
      this.lists.set(study, list);
    }
    return list;
  }
}

function evaluated({ success_rate, wall_contact_rate }: Record<string, number | null>): string | null {
  const success = success_rate === null ? null : success_rate === 0 ? "no successes" : `success ${percent(success_rate)}`;
  const contact = wall_contact_rate === null ? null : `wall contact ${percent(wall_contact_rate)}`;
  const facts = [success, contact].filter(Boolean).join(", ");
  return facts && `in its evaluation ${facts}`;
}

function percent(share: number): string {
  return `${Math.round(100 * share)}%`;
}

function put(node: HTMLElement, text: string): void {
  if (node.textContent !== text) node.textContent = text;
}

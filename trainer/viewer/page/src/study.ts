// The report of a study: claims, results, figures, and each curve's runs.

import { number } from "./axes";
import { Result, Study, element, make } from "./data";
import "./study.css";
import { Cell, EVALUATION, dataTable, evaluationCells } from "./tables";

type Format = (value: number) => string;
const percent: Format = (value) => `${number(100 * value, 1)}%`;
const whole: Format = (value) => number(value, 0);
const thousands: Format = (value) => number(value / 1000, 0);

// Columns of the results: name, title, format, and what stands where an arm has no number.
const RESULTS: [string, string, Format, string][] = [
  ["success_rate", "success", percent, "not reported"],
  ["mean_return", "return", (value) => number(value, 2), "not reported"],
  ["mean_episode_length", "episode length, decisions", whole, "not reported"],
  ["mean_success_length", "length of successes, decisions", whole, "no successes"],
  ["opponent_contact_rate", "opponent contact, episodes", percent, "not reported"],
  ["wall_contact_rate", "wall contact, episodes", percent, "not reported"],
  ["steps_to_50_success", "thousand steps to 50% success", thousands, "never reached"],
  ["steps_to_90_success", "thousand steps to 90% success", thousands, "never reached"],
];

export function showStudy(study: Study): void {
  const home = element("study");
  home.hidden = false;
  home.classList.add("study");
  if (study.claims.length) section(home, "Claims of the paper", claims(study));
  if (study.results.some(({ measures }) => Object.keys(measures).length)) {
    const explained =
      "Interquartile means over seeds with 95% bootstrap intervals, of each run's evaluation at the end. Steps to a success " +
      "rate are those until so many of the last 100 training episodes succeeded; a run that never gets there counts with all its steps.";
    section(home, "Results", make("p", explained, { className: "muted" }), results(study.results));
  }
  for (const { title, caption, source } of study.figures) {
    const figure = make("figure");
    figure.append(make("img", "", { src: source, alt: `${title}: learning curves or means, described below` }), make("figcaption", caption));
    section(home, title, figure);
  }
  for (const group of study.groups) {
    const rows = group.runs.map(({ run_id, evaluation, replay }): Cell[] => [
      replay ? make("a", run_id, { href: replay }) : `${run_id}, no replay`,
      ...(evaluation ? evaluationCells(evaluation) : EVALUATION.map((_, column) => (column ? "" : "not evaluated"))),
    ]);
    const table = blocks(dataTable(`Runs of ${group.name}`, ["run and its replay", ...EVALUATION.map(([, title]) => title)], rows));
    table.classList.add("even");
    section(home, group.name, table);
  }
}

// What stands above a replay that was opened from a report; nothing above any other.
export function wayBack(): HTMLElement | null {
  const from = new URLSearchParams(location.search).get("from") ?? "";
  if (!/^(\.\.\/)+([^/\\:?#]+\/)*report\.html$/.test(from)) return null;
  return make("a", "‹ the study's report", { href: encodeURI(from), className: "back" });
}

function claims({ claims }: Study): HTMLElement {
  const rows = claims.map(({ id, statement, measure, holds, evidence }): Cell[] => {
    const verdict = holds === null ? "not decided" : holds ? "yes" : "no";
    return [id, statement, measure, make("b", verdict, { className: `verdict ${holds === null ? "open" : verdict}` }), evidence];
  });
  return blocks(dataTable("Claims of the paper", ["claim", "the paper says", "decided by", "holds", "evidence"], rows));
}

function results(arms: Result[]): HTMLElement {
  const columns = RESULTS.filter(([name]) => arms.some(({ measures }) => name in measures));
  const rows = arms.map(({ label, runs, measures }): Cell[] => [
    label,
    runs === null ? "" : whole(runs),
    ...columns.map(([name, , format, none]) => {
      const found = measures[name];
      if (!found) return none;
      const cell = make("span");
      cell.append(format(found[0]), make("small", ` [${format(found[1])}, ${format(found[2])}]`));
      return cell;
    }),
  ]);
  return blocks(dataTable("Results by arm", ["arm", "runs", ...columns.map(([, title]) => title)], rows));
}

function blocks(table: HTMLTableElement): HTMLTableElement {
  table.classList.add("blocks");
  return table;
}

function section(home: HTMLElement, title: string, ...content: HTMLElement[]): void {
  const box = make("section");
  box.append(make("h2", title), ...content);
  home.append(box);
}

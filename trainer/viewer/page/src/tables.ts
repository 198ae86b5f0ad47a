// Tables that become a list of blocks where there is no room for columns.

import { make } from "./data";

export type Cell = string | Node;

// A column's head stands in each of its cells, too (data-head), for the narrow form; roles, because a browser forgets
// that a table is one when its rows are laid out otherwise.
export function dataTable(caption: string, head: Cell[], rows: Cell[][]): HTMLTableElement {
  const table = make("table", "", { className: "data" });
  table.setAttribute("role", "table");
  const titles = head.map((cell) => (typeof cell === "string" ? cell : cell.textContent ?? ""));
  const line = (cells: Cell[], kind: (column: number) => "columnheader" | "rowheader" | "cell") => {
    const row = make("tr");
    row.setAttribute("role", "row");
    cells.forEach((content, column) => {
      const role = kind(column);
      const cell = make(role === "cell" ? "td" : "th");
      cell.setAttribute("role", role);
      if (role !== "cell") cell.setAttribute("scope", role === "rowheader" ? "row" : "col");
      cell.dataset.head = titles[column];
      cell.append(content);
      row.append(cell);
    });
    return row;
  };
  const group = (tag: "thead" | "tbody", lines: HTMLElement[]) => {
    const part = make(tag);
    part.setAttribute("role", "rowgroup");
    part.append(...lines);
    return part;
  };
  table.append(
    make("caption", caption, { className: "unseen" }),
    group("thead", [line(head, () => "columnheader")]),
    group("tbody", rows.map((cells) => line(cells, (column) => (column === 0 ? "rowheader" : "cell")))),
  );
  return table;
}

// Something wide in a box of its own that scrolls, with keys too.
export function scrolling(content: HTMLElement, label: string): HTMLElement {
  const box = make("div", "", { className: "scrolling", tabIndex: 0 });
  box.setAttribute("role", "region");
  box.setAttribute("aria-label", label);
  box.append(content);
  return box;
}

export type Numbers = Record<string, number | null>;

// The columns that a run's evaluation has, with what stands where there is no number.
export const EVALUATION: [string, string][] = [
  ["success_rate", "success"],
  ["mean_return", "return"],
  ["mean_episode_length", "episode length, decisions"],
  ["mean_success_length", "length of successes, decisions"],
  ["opponent_contact_rate", "opponent contact, episodes"],
  ["wall_contact_rate", "wall contact, episodes"],
];

export function evaluationCells(evaluation: Numbers): string[] {
  return EVALUATION.map(([name]) => {
    const value = evaluation[name] ?? null;
    if (value === null) return name === "mean_success_length" && evaluation.success_rate === 0 ? "no successes" : "not reported";
    if (name.endsWith("_rate")) return `${+(100 * value).toFixed(1)}%`;
    return name === "mean_return" ? value.toFixed(2).replace("-", "−") : value.toFixed(0);
  });
}

// The report of a study: claims, figures, and each curve's runs.

import { Study, element, make } from "./data";

export function showStudy(study: Study): void {
  const home = element("study");
  home.hidden = false;
  home.classList.add("study");
  if (study.claims.length) {
    const table = make("table");
    const head = make("tr");
    head.append(...["", "the paper says", "decided by", "holds", "evidence"].map((text) => make("th", text)));
    table.append(head);
    for (const claim of study.claims) {
      const row = make("tr");
      const verdict = claim.holds === null ? "not decided" : claim.holds ? "yes" : "no";
      row.append(
        make("td", claim.id), make("td", claim.statement), make("td", claim.measure),
        make("td", verdict, { className: claim.holds === null ? "muted" : verdict }), make("td", claim.evidence),
      );
      table.append(row);
    }
    section(home, "Claims", table);
  }
  for (const figure of study.figures) section(home, figure.title, make("img", "", { src: figure.source, alt: figure.title }));
  for (const group of study.groups) {
    const list = make("ul", "", { className: "list" });
    for (const run of group.runs) {
      const item = make("li");
      const link = run.replay ? make("a", run.run_id, { href: run.replay }) : make("span", run.run_id);
      const label = make("label");
      label.append(make("span"), link, make("span", run.replay ? "" : "no replay", { className: "muted" }), make("small", run.facts));
      item.append(label);
      list.append(item);
    }
    section(home, group.name, list);
  }
}

function section(home: HTMLElement, title: string, content: HTMLElement): void {
  const box = make("section");
  box.append(make("h2", title), content);
  home.append(box);
}

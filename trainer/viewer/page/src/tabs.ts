// Tabs as the ARIA pattern has them: one stop of the Tab key, arrows between them, and each with its panel.

import { element, make } from "./data";

export class Tabs<Name extends string> {
  private readonly buttons = new Map<Name, HTMLButtonElement>();

  constructor(
    names: Record<Name, string>,
    private readonly onOpen: (name: Name, enter?: () => void) => void,
    private readonly onEnter: (name: Name) => void, // a tab was pressed: whoever did wants its panel's keys
  ) {
    const home = element("tabs");
    home.hidden = false;
    home.setAttribute("role", "tablist");
    home.setAttribute("aria-label", "What to see");
    for (const [name, text] of Object.entries(names) as [Name, string][]) {
      const button = make("button", text, { id: `tab-${name}` });
      button.dataset.tab = name;
      button.setAttribute("role", "tab");
      button.setAttribute("aria-controls", name);
      button.addEventListener("click", () => {
        this.open(name);
        this.onEnter(name);
      });
      const panel = element(name);
      panel.setAttribute("role", "tabpanel");
      panel.setAttribute("aria-labelledby", button.id);
      this.buttons.set(name, button);
      home.append(button);
    }
    home.addEventListener("keydown", (event) => {
      const all = [...this.buttons.keys()];
      const at = all.findIndex((name) => this.buttons.get(name) === document.activeElement);
      const to: Record<string, number> = {
        ArrowRight: (at + 1) % all.length, ArrowLeft: (at + all.length - 1) % all.length, Home: 0, End: all.length - 1,
      };
      if (at < 0 || !(event.key in to)) return;
      event.preventDefault();
      this.open(all[to[event.key]]);
      this.buttons.get(all[to[event.key]])!.focus();
    });
  }

  // enter: what is done there instead of what is done by default.
  open(next: Name, enter?: () => void): void {
    for (const [name, button] of this.buttons) {
      button.setAttribute("aria-selected", String(name === next));
      button.tabIndex = name === next ? 0 : -1;
      element(name).hidden = name !== next;
    }
    this.onOpen(next, enter);
  }
}

// The list of episodes beside the stage: a list box, whose selected episode is the one on the stage.

import { EpisodeRecord, Scene, Track, element, make, seconds, signed, unpack } from "./data";
import { Second, Stage, speak } from "./stage";

type Filter = "all" | "successes" | "failures" | "closest";

const KEEP: Record<Filter, (episode: EpisodeRecord) => boolean> = {
  all: () => true,
  successes: (episode) => episode.outcome === "goal",
  failures: (episode) => episode.outcome !== "goal",
  closest: () => true,
};
const NAMES: Record<Filter, string> = {
  all: "all", successes: "successes", failures: "failures", closest: "closest calls",
};
const OUTCOME = { goal: "reached", failed: "failed", truncated: "cut", ended: "ended" };

export class EpisodeList {
  onStage: number | null = null; // the episode that the stage has
  // The same episode of another run, if one is to be shown beside.
  secondOf: (number: number, track: Track) => Promise<Second | null> = async () => null;
  private scene: Scene | null = null;
  private filter: Filter = "all";
  private shown: EpisodeRecord | null = null;
  private readonly home = element("episode-list");

  constructor(private readonly stage: Stage, private readonly onError: (message: string) => void) {
    for (const name of Object.keys(KEEP) as Filter[]) {
      const button = make("button", NAMES[name]);
      button.dataset.filter = name;
      button.addEventListener("click", () => this.setFilter(name));
      element("filters").append(button);
    }
    this.home.addEventListener("click", (event) => {
      const item = (event.target as Element).closest<HTMLElement>("[data-number]");
      const record = this.scene?.episodes.find((each) => String(each.number) === item?.dataset.number);
      if (record) void this.select(record, { focus: true });
    });
    element("next-episode").addEventListener("click", () => this.next());
  }

  get current(): EpisodeRecord | null {
    return this.shown;
  }

  get run(): string {
    return this.scene?.run.run_id ?? "";
  }

  // Takes up an evaluation and shows one of its episodes, by default the most telling: a success with a close call.
  async setScene(scene: Scene, number?: number, time = 0): Promise<void> {
    this.scene = scene;
    const best = [...scene.episodes].sort(
      (a, b) => Number(b.outcome === "goal") - Number(a.outcome === "goal") || a.closest - b.closest,
    )[0];
    const all = scene.evaluated === scene.episodes.length ? "" : ` of ${scene.evaluated}`;
    element("episode-count").textContent =
      `${scene.episodes.length}${all} evaluated episodes, policy after ${scene.env_steps.toLocaleString("en")} steps.`;
    const chosen = scene.episodes.find((record) => record.number === number) ?? best;
    if (chosen && !KEEP[this.filter](chosen)) this.filter = "all";
    this.draw();
    if (chosen) await this.select(chosen, { time });
  }

  // focus: the list takes the focus. It does so by itself if it has it, or if nothing has it.
  async select(record: EpisodeRecord, { time = 0, focus = false } = {}): Promise<void> {
    const { scene } = this;
    if (!scene) return;
    this.shown = record;
    this.mark(focus);
    try {
      const track = await unpack(record, scene.corridor);
      const second = await this.secondOf(record.number, track);
      if (this.shown !== record) return;
      this.onStage = record.number;
      this.stage.name = scene.run.run_id;
      this.stage.ghost = null;
      this.stage.show(track, Math.round(time / scene.corridor.decision_seconds), second);
      element("episode-title").textContent = `Episode ${record.number}: ${this.facts(record)}`;
      if (!this.home.contains(document.activeElement)) speak(element("episode-title").textContent!);
    } catch (error) {
      this.onError(error instanceof Error && error.message.startsWith("Episode") ? error.message : `Episode ${record.number} is broken and can't be shown.`);
    }
  }

  // For a list that is still to come, nobody has the focus until it is there.
  focus(): void {
    if (this.shown) this.mark(true);
    else (document.activeElement as HTMLElement | null)?.blur();
  }

  move(by: number): void {
    const list = this.visible();
    const at = list.findIndex((record) => record === this.shown);
    const next = list[Math.min(Math.max(at + by, 0), list.length - 1)];
    if (next && next !== this.shown) void this.select(next, { focus: true });
    else this.mark(true);
  }

  // The next one of those listed, after the last the first, played if this one was.
  next(): void {
    const list = this.visible();
    const next = list[(list.findIndex((record) => record === this.shown) + 1) % Math.max(list.length, 1)];
    if (next) void this.select(next);
  }

  facts(record: EpisodeRecord): string {
    const time = seconds(record.length, this.scene?.corridor.decision_seconds ?? 0.1);
    return `${OUTCOME[record.outcome]} after ${time} s, return ${signed(record.return, 2)}`;
  }

  private setFilter(filter: Filter): void {
    this.filter = filter;
    this.draw();
    const list = this.visible();
    if (list.length && !list.includes(this.shown!)) void this.select(list[0]);
  }

  private visible(): EpisodeRecord[] {
    const list = (this.scene?.episodes ?? []).filter(KEEP[this.filter]);
    return this.filter === "closest" ? list.sort((a, b) => a.closest - b.closest) : list;
  }

  // The list anew; which of it is selected is marked afterwards.
  private draw(): void {
    document.querySelectorAll<HTMLElement>("#filters button").forEach((button) => {
      const name = button.dataset.filter as Filter;
      button.setAttribute("aria-pressed", String(name === this.filter));
      const count = (this.scene?.episodes ?? []).filter(KEEP[name]).length;
      button.textContent = name === "closest" ? NAMES[name] : `${NAMES[name]} ${count}`;
    });
    const period = this.scene?.corridor.decision_seconds ?? 0.1;
    const focused = this.home.contains(document.activeElement);
    this.home.replaceChildren(
      ...this.visible().map((record) => {
        const item = make("li");
        item.setAttribute("role", "option");
        item.dataset.number = String(record.number);
        item.append(
          make("i", "", { className: `mark ${record.outcome}` }),
          make("span", `${record.number} · ${OUTCOME[record.outcome]}`),
          make("span", signed(record.return, 2), { title: "return" }),
          make("small", `${seconds(record.length, period)} s, closest ${record.closest.toFixed(2)}`),
        );
        return item;
      }),
    );
    this.mark(focused);
  }

  // The selected one is seen, without the page being moved, and is the list's stop of the Tab key.
  private mark(focus: boolean): void {
    const items = [...this.home.querySelectorAll<HTMLElement>("li")];
    const selected = items.find((item) => item.dataset.number === String(this.shown?.number)) ?? null;
    for (const item of items) {
      item.setAttribute("aria-selected", String(item === selected));
      item.tabIndex = item === (selected ?? items[0]) ? 0 : -1;
    }
    if (!selected) return;
    const home = this.home.getBoundingClientRect();
    const box = selected.getBoundingClientRect();
    if (box.top < home.top) this.home.scrollTop -= home.top - box.top;
    else if (box.bottom > home.bottom) this.home.scrollTop += box.bottom - home.bottom;
    const nobody = document.activeElement === document.body || document.activeElement === null;
    if (focus || nobody || this.home.contains(document.activeElement)) selected.focus({ preventScroll: true });
  }
}

// The list of episodes beside the stage.

import { EpisodeRecord, Scene, element, make, signed, unpack } from "./data";
import { Stage } from "./stage";

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

export class EpisodeList {
  private scene: Scene | null = null;
  private filter: Filter = "all";
  private shown: EpisodeRecord | null = null;
  onStage: number | null = null; // the episode that the stage has

  constructor(private readonly stage: Stage, private readonly onError: (message: string) => void) {
    for (const name of Object.keys(KEEP) as Filter[]) {
      const button = make("button", NAMES[name]);
      button.dataset.filter = name;
      button.addEventListener("click", () => this.setFilter(name));
      element("filters").append(button);
    }
  }

  // Takes up an evaluation and shows its most telling episode: a success with a close call, if there is one.
  async setScene(scene: Scene): Promise<void> {
    this.scene = scene;
    const best = [...scene.episodes].sort(
      (a, b) => Number(b.outcome === "goal") - Number(a.outcome === "goal") || a.closest - b.closest,
    )[0];
    const all = scene.evaluated === scene.episodes.length ? "" : ` of ${scene.evaluated}`;
    element("episode-count").textContent =
      `${scene.episodes.length}${all} evaluated episodes, policy after ${scene.env_steps.toLocaleString("en")} steps.`;
    this.draw();
    if (best) await this.select(best);
  }

  async select(record: EpisodeRecord): Promise<void> {
    if (!this.scene) return;
    this.shown = record;
    this.draw();
    try {
      const track = await unpack(record, this.scene.corridor);
      if (this.shown === record) {
        this.stage.show(track);
        this.onStage = record.number;
      }
    } catch (error) {
      this.onError(error instanceof Error && error.message.startsWith("Episode") ? error.message : `Episode ${record.number} is broken and can't be shown.`);
    }
  }

  move(by: number): void {
    const list = this.visible();
    const at = list.findIndex((record) => record === this.shown);
    const next = list[Math.min(Math.max(at + by, 0), list.length - 1)];
    if (next) void this.select(next);
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

  private draw(): void {
    document.querySelectorAll<HTMLElement>("#filters button").forEach((button) => {
      const name = button.dataset.filter as Filter;
      button.setAttribute("aria-pressed", String(name === this.filter));
      const count = (this.scene?.episodes ?? []).filter(KEEP[name]).length;
      button.textContent = name === "closest" ? NAMES[name] : `${NAMES[name]} ${count}`;
    });
    const seconds = this.scene?.corridor.decision_seconds ?? 0.1;
    element("episode-list").replaceChildren(
      ...this.visible().map((record) => {
        const button = make("button");
        button.setAttribute("aria-current", String(record === this.shown));
        button.dataset.number = String(record.number);
        button.append(
          make("i", "", { className: `mark ${record.outcome}` }),
          make("span", `${record.number} · ${OUTCOME[record.outcome]}`),
          make("span", signed(record.return, 2), { title: "return" }),
          make("small", `${(record.length * seconds).toFixed(1)} s, closest ${record.closest.toFixed(2)}`),
        );
        button.addEventListener("click", () => void this.select(record));
        const item = make("li");
        item.append(button);
        return item;
      }),
    );
  }
}

const OUTCOME = { goal: "reached", failed: "failed", truncated: "cut", ended: "ended" };

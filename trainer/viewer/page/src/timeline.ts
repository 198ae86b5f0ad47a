// The time line: the slider, the marks over it, and their legend, whose entries go to the next mark of their kind.

import { Track, element, make, seconds } from "./data";
import { Mark, Span, spans } from "./events";

const NAMES: Record<Mark, string> = {
  switch: "switch on", near: "near", contact: "contact", wall: "wall", end: "end",
};
const END = { goal: "target reached", failed: "failed", truncated: "cut by the step limit", ended: "ended" };

export class Timeline {
  readonly slider = element<HTMLInputElement>("scrub");
  private readonly keys = new Map<Mark, HTMLButtonElement>();
  private track: Track | null = null;
  private found: Span[] = [];
  private spoken = -1;

  constructor(private readonly onSeek: (time: number) => void, private readonly now: () => number) {
    this.slider.addEventListener("input", () => onSeek(Number(this.slider.value)));
    for (const mark of Object.keys(NAMES) as Mark[]) {
      const button = make("button");
      button.dataset.mark = mark;
      button.addEventListener("click", () => this.next(mark));
      element("mark-legend").append(button);
      this.keys.set(mark, button);
    }
  }

  show(track: Track, beside: Track | null): void {
    this.track = track;
    this.found = spans(track);
    const end = Math.max(track.rows, beside?.rows ?? 0) - 1;
    this.slider.max = String(end);
    this.spoken = -1;
    const lanes = [this.found, ...(beside ? [spans(beside)] : [])].map((all, lane) => {
      const home = make("div", "", { className: "lane" });
      const outcome = (lane ? beside! : track).outcome;
      for (const { mark, from, to } of all) {
        const piece = make("i", "", { className: `at-${mark}${mark === "end" ? ` mark ${outcome}` : ""}` });
        piece.style.left = `${(100 * from) / Math.max(end, 1)}%`;
        if (to > from) piece.style.width = `${(100 * (to - from)) / Math.max(end, 1)}%`;
        home.append(piece);
      }
      return home;
    });
    element("marks").replaceChildren(...lanes);
    for (const [mark, button] of this.keys) this.name(mark, button);
  }

  // The slider follows; what it says changes with whole decisions, and once a second while the episode plays.
  move(row: number, playing: boolean): void {
    const { track, slider } = this;
    if (!track || Number(slider.value) === row && this.spoken === row) return;
    if (slider.value !== String(row)) slider.value = String(row);
    const period = track.corridor.decision_seconds;
    if (playing && this.spoken >= 0 && Math.abs(row - this.spoken) * period < 1) return;
    this.spoken = row;
    const ending = row >= track.rows - 1 && track.outcome ? `, ${END[track.outcome]}` : "";
    slider.setAttribute("aria-valuetext", `${seconds(row, period)} of ${seconds(Number(slider.max), period)} seconds${ending}`);
  }

  private name(mark: Mark, button: HTMLButtonElement): void {
    const { track, found } = this;
    const all = found.filter((span) => span.mark === mark);
    const time = (rows: number) => `${seconds(rows, track!.corridor.decision_seconds)} s`;
    const decisions = all.reduce((sum, span) => sum + span.to - span.from, 0);
    const text = !all.length ? "never" : mark === "end" || mark === "switch" ? time(all[0].from) : time(decisions);
    const kind = mark === "end" ? `mark ${track!.outcome ?? "ended"}` : "";
    button.replaceChildren(make("i", "", { className: `at-${mark} ${kind}` }), NAMES[mark], make("b", text));
    button.disabled = !all.length;
    button.title = all.length > 1 ? `${all.length} times; press to go to the next` : "press to go there";
  }

  private next(mark: Mark): void {
    const all = this.found.filter((span) => span.mark === mark);
    const place = (span: Span) => (mark === "end" || mark === "switch" ? span.from : span.from + 1);
    const next = all.find((span) => place(span) > this.now()) ?? all[0];
    if (next) this.onSeek(place(next));
  }
}

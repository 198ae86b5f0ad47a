// The stage: the views, the numbers, the time line and the charts, for one episode, or the same one of two runs.

import { Track, element, make, seconds, signed } from "./data";
import { EpisodeCharts } from "./episode_charts";
import { Readout } from "./readout";
import { Theme, onThemeChange, theme } from "./theme";
import { Timeline } from "./timeline";
import { TopView } from "./topview";
import { View3D } from "./view3d";

export const END = { goal: "target reached", failed: "failed", truncated: "cut by the step limit", ended: "ended" };

// What else is shown of the same episode: a second run beside the first, or the policy's way under somebody's own.
export interface Second {
  track: Track;
  name: string;
}

export class Stage {
  track: Track | null = null;
  time = 0; // in decisions
  driving = false;
  name = "";
  beside: Second | null = null;
  ghost: Track | null = null; // drawn in the top view, at the same time
  onRest: () => void = () => {}; // the time is another one and stays there
  onEnd: () => void = () => {};
  private playing = false;
  private looping = false;
  private theme: Theme = theme();
  private view3d: View3D | null = null;
  private readonly top = new TopView(element<HTMLCanvasElement>("canvas-top"));
  private readonly topBeside = new TopView(element<HTMLCanvasElement>("canvas-beside"));
  private readonly readouts = [new Readout(element("readout")), new Readout(element("readout-beside"))];
  private readonly speed = element<HTMLSelectElement>("speed");
  private readonly timeline = new Timeline((time) => this.goTo(time), () => this.time);
  private readonly charts = new EpisodeCharts((row) => {
    if (!this.driving) this.goTo(row);
  });
  private dirty = false;
  private last = 0;
  private frames: number[] = [];

  constructor() {
    try {
      this.view3d = new View3D(element<HTMLCanvasElement>("canvas3d"), () => this.redraw());
    } catch {
      document.body.classList.add("no-webgl");
      element("no-webgl").hidden = false;
    }
    const on = (id: string, action: () => void) => element(id).addEventListener("click", action);
    on("play", () => this.toggle());
    on("to-start", () => this.goTo(0));
    on("step", () => this.step(1));
    on("step-back", () => this.step(-1));
    on("loop", () => this.toggleLoop());
    on("follow", () => this.toggleFollow());
    on("reset-camera", () => this.resetCamera());
    onThemeChange(() => this.repaint());
    new ResizeObserver(() => this.redraw()).observe(element("stage"));
    // A printer takes what is drawn now.
    addEventListener("beforeprint", () => {
      this.theme = theme();
      this.drawCharts();
      this.draw();
    });
    addEventListener("afterprint", () => this.repaint());
  }

  show(track: Track, time = 0, beside: Second | null = null): void {
    this.track = track;
    this.beside = beside;
    document.body.classList.toggle("comparing", beside !== null);
    this.time = Math.min(time, this.end);
    document.querySelectorAll<HTMLElement>(".legend .known").forEach((entry) => (entry.hidden = track.targets === null));
    element("ghost-key").hidden = this.ghost === null;
    this.timeline.show(track, beside?.track ?? null);
    this.drawCharts();
    this.redraw();
    this.onRest();
  }

  // While driving: the track has grown; follow its end, with the charts at their own, slower pace.
  grown(charts: boolean): void {
    this.time = this.end;
    if (charts) this.drawCharts();
    this.redraw();
  }

  get end(): number {
    return Math.max((this.track?.rows ?? 1) - 1, (this.beside?.track.rows ?? 1) - 1, 0);
  }

  get isPlaying(): boolean {
    return this.playing;
  }

  seek(time: number): void {
    this.time = Math.min(Math.max(time, 0), this.end);
    this.redraw();
    if (!this.playing) this.onRest();
  }

  goTo(time: number): void {
    this.pause();
    this.seek(time);
  }

  step(by: number): void {
    this.goTo(by > 0 ? Math.floor(this.time) + by : Math.ceil(this.time) + by);
  }

  toggle(): void {
    if (this.playing) this.pause();
    else this.play();
  }

  play(): void {
    if (!this.track) return;
    if (this.time >= this.end) this.time = 0;
    this.playing = true;
    this.last = 0;
    element("play").classList.add("playing");
    element("play").setAttribute("aria-label", "Pause");
    this.redraw();
  }

  pause(): void {
    if (this.playing) this.onRest();
    this.playing = false;
    element("play").classList.remove("playing");
    element("play").setAttribute("aria-label", "Play");
    this.redraw();
  }

  toggleLoop(): void {
    this.looping = !this.looping;
    element("loop").setAttribute("aria-pressed", String(this.looping));
  }

  toggleFollow(): void {
    if (!this.view3d) return;
    this.view3d.setFollowing(!this.view3d.following, this.track?.corridor);
    element("follow").setAttribute("aria-pressed", String(this.view3d.following));
    this.redraw();
  }

  resetCamera(): void {
    if (!this.view3d || !this.track) return;
    this.view3d.setFollowing(false, this.track.corridor);
    element("follow").setAttribute("aria-pressed", "false");
    this.view3d.resetCamera(this.track.corridor);
    this.redraw();
  }

  redraw(): void {
    if (this.dirty) return;
    this.dirty = true;
    requestAnimationFrame((now) => this.frame(now));
  }

  // Milliseconds of script that the latest frames took.
  get frameCosts(): readonly number[] {
    return this.frames;
  }

  // Where the camera looks, x, y and z in metres; null without WebGL.
  get cameraTarget(): number[] | null {
    return this.view3d?.lookedAt ?? null;
  }

  private repaint(): void {
    this.theme = theme();
    this.drawCharts();
    this.redraw();
  }

  private frame(now: number): void {
    const began = performance.now();
    this.dirty = false;
    if (!this.track || element("stage").offsetParent === null) return;
    if (this.playing) this.pass(now, this.track.corridor.decision_seconds);
    this.draw();
    if (this.playing) this.redraw();
    this.frames = [...this.frames.slice(-299), performance.now() - began];
  }

  private pass(now: number, period: number): void {
    const passed = this.last ? Math.min((now - this.last) / 1000, 0.25) : 0;
    this.last = now;
    this.time += (passed * Number(this.speed.value)) / period;
    if (this.time < this.end) return;
    if (this.looping) {
      this.time = 0;
      return;
    }
    this.time = this.end;
    this.pause();
    this.onEnd();
  }

  private draw(): void {
    const { track, beside } = this;
    if (!track) return;
    this.top.draw(track, this.time, this.theme, this.ghost);
    if (beside) this.topBeside.draw(beside.track, this.time, this.theme, null);
    else this.view3d?.draw(track, this.time, this.theme);
    this.readouts[0].show(track, this.time, beside ? this.name : null);
    this.readouts[1].show(beside?.track ?? null, this.time, beside?.name ?? null);
    this.showClock(track);
    this.charts.moveHead(this.time);
  }

  private showClock(track: Track): void {
    const row = Math.min(Math.floor(this.time), this.end);
    const time = (decisions: number) => seconds(decisions, track.corridor.decision_seconds);
    const ending = row === this.end && track.outcome && !this.beside ? ` · ${END[track.outcome]}` : "";
    const clock = `${time(row)} / ${time(this.end)} s${ending}`;
    const output = element("clock");
    if (output.textContent !== clock) output.textContent = clock;
    output.title = `decision ${row} of ${this.end}`;
    this.timeline.move(row, this.playing);
    const { beside } = this;
    const caption = (id: string, name: string, shown: Track) => {
      const text = `${name}: ${END[shown.outcome ?? "ended"]} after ${time(shown.rows - 1)} s, return ${signed(shown.returns.at(-1)!, 2)}`;
      if (element(id).textContent !== text) element(id).textContent = text;
    };
    element("caption-top").hidden = element("view-beside").hidden = !beside;
    if (beside) {
      caption("caption-top", this.name, track);
      caption("caption-beside", beside.name, beside.track);
    }
  }

  private drawCharts(): void {
    if (this.track) this.charts.draw(this.track, this.beside?.track ?? null, this.theme);
  }
}

// For a screen reader, without a place on the screen.
export function speak(sentence: string): void {
  element("spoken").replaceChildren(make("span", sentence));
}

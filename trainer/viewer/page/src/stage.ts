// The stage: both views, the numbers, the transport and the charts, for one episode at a time.

import { CASES, Track, caseOf, element, make, signed } from "./data";
import { Chart, key } from "./charts";
import { Theme, onThemeChange, theme } from "./theme";
import { TopView } from "./topview";
import { View3D } from "./view3d";

const END = { goal: "target reached", failed: "failed", truncated: "cut by the step limit", ended: "ended" };

export class Stage {
  track: Track | null = null;
  time = 0; // in decisions
  driving = false;
  onFrame: () => void = () => {};
  private playing = false;
  private theme: Theme = theme();
  private view3d: View3D | null = null;
  private readonly top = new TopView(element<HTMLCanvasElement>("canvas-top"));
  private readonly scrub = element<HTMLInputElement>("scrub");
  private readonly speed = element<HTMLSelectElement>("speed");
  private readonly values = new Map<string, HTMLElement>();
  private charts: { chart: Chart; draw: (chart: Chart) => void }[] = [];
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
    this.makeReadout();
    this.makeCharts();
    element("play").addEventListener("click", () => this.toggle());
    element("to-start").addEventListener("click", () => this.seek(0));
    element("step").addEventListener("click", () => this.step(1));
    element("step-back").addEventListener("click", () => this.step(-1));
    element("reset-camera").addEventListener("click", () => this.resetCamera());
    this.scrub.addEventListener("input", () => {
      this.pause();
      this.seek(Number(this.scrub.value));
    });
    onThemeChange(() => this.repaint());
    new ResizeObserver(() => this.redraw()).observe(element("stage"));
  }

  show(track: Track, time = 0): void {
    this.track = track;
    this.time = Math.min(time, this.end);
    this.scrub.max = String(this.end);
    document.querySelectorAll<HTMLElement>(".legend .known").forEach((entry) => (entry.hidden = track.targets === null));
    this.drawCharts();
    this.redraw();
  }

  // While driving: the track has grown; follow its end, with the charts at their own, slower pace.
  grown(charts: boolean): void {
    this.time = this.end;
    if (charts) this.drawCharts();
    this.redraw();
  }

  get end(): number {
    return Math.max((this.track?.rows ?? 1) - 1, 0);
  }

  get isPlaying(): boolean {
    return this.playing;
  }

  seek(time: number): void {
    this.time = Math.min(Math.max(time, 0), this.end);
    this.redraw();
  }

  step(by: number): void {
    this.pause();
    this.seek(by > 0 ? Math.floor(this.time) + by : Math.ceil(this.time) + by);
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
    this.redraw();
  }

  pause(): void {
    this.playing = false;
    element("play").classList.remove("playing");
  }

  resetCamera(): void {
    if (this.track) this.view3d?.resetCamera(this.track.corridor);
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

  private repaint(): void {
    this.theme = theme();
    this.drawCharts();
    this.redraw();
  }

  private frame(now: number): void {
    const began = performance.now();
    this.dirty = false;
    const { track } = this;
    if (!track || element("stage").offsetParent === null) return;
    if (this.playing) {
      const seconds = this.last ? Math.min((now - this.last) / 1000, 0.25) : 0;
      this.last = now;
      this.time += (seconds * Number(this.speed.value)) / track.corridor.decision_seconds;
      if (this.time >= this.end) {
        this.time = this.end;
        this.pause();
      }
    }
    this.top.draw(track, this.time, this.theme);
    this.view3d?.draw(track, this.time, this.theme);
    this.showNumbers(track);
    for (const { chart } of this.charts) chart.moveHead(this.time);
    this.onFrame();
    if (this.playing) this.redraw();
    this.frames = [...this.frames.slice(-299), performance.now() - began];
  }

  private makeReadout(): void {
    const names = [
      ["reward", "reward"], ["return", "return so far"], ["d", "d_opp"], ["switch", "switch"],
      ["goal", "to the target"], ["case", "eq. 9 says"],
    ];
    for (const [name, label] of names) {
      const box = make("div", "", { className: name === "case" ? "case" : "wide" });
      const value = make("b");
      box.append(make("small", label), value);
      element("readout").append(box);
      this.values.set(name, value);
    }
  }

  private showNumbers(track: Track): void {
    const row = Math.min(Math.floor(this.time), this.end);
    const put = (name: string, text: string) => {
      const node = this.values.get(name)!;
      if (node.textContent !== text) node.textContent = text;
    };
    const found = caseOf(track, row);
    const scale = track.corridor.half_length;
    const toGoal = Math.hypot(track.goal[0] - track.at("p_x", row) * scale, track.goal[1] - track.at("p_z", row) * scale);
    put("reward", row ? signed(track.at("reward", row), 3) : "–");
    put("return", signed(track.returns[row], 3));
    put("d", track.nearest(row).toFixed(3));
    put("switch", track.at("switch", row) > 0.5 ? "on" : "off");
    put("goal", `${toGoal.toFixed(1)} m`);
    put("case", row === 0 ? "–" : found ? CASES[found.name] + (found.failed ? "; failed: −1 more" : "") : "–");
    const seconds = (decisions: number) => (decisions * track.corridor.decision_seconds).toFixed(1);
    const ending = row === this.end && track.outcome ? ` · ${END[track.outcome]}` : "";
    const clock = `${seconds(row)} / ${seconds(this.end)} s${ending}`;
    const output = element<HTMLOutputElement>("clock");
    if (output.textContent !== clock) output.textContent = clock;
    output.title = `decision ${row} of ${this.end}`;
    if (this.scrub.value !== String(row)) this.scrub.value = String(row);
  }

  private makeCharts(): void {
    const home = element("charts");
    const add = (name: string, height: number, range: [number, number] | "from zero" | undefined, draw: (chart: Chart) => void, levels?: () => { value: number; colour: string; fillBelow?: boolean }[]) => {
      const box = make("div", "", { className: name });
      home.append(box);
      const seconds = (value: number) => `${+(value * (this.track?.corridor.decision_seconds ?? 0.1)).toFixed(1)} s`;
      const options = {
        height, x: seconds,
        range: range === "from zero" ? undefined : range,
        fromZero: range === "from zero",
        onSeek: (x: number) => {
          if (this.driving) return;
          this.pause();
          this.seek(Math.round(x));
        },
        get levels() {
          return levels?.() ?? [];
        },
      };
      this.charts.push({ chart: new Chart(box, options), draw });
    };
    add("of-reward", 112, undefined, (chart) => {
      const { track, theme } = this;
      if (!track) return;
      chart.show(rows(track), [
        { label: "return", colour: theme.muted, values: track.returns, width: 1.4 },
        { label: "reward", colour: theme.learner, values: track.columns.get("reward")!, stepped: true },
      ], theme, [make("b", "reward"), key("each decision", theme.learner), key("return so far", theme.muted)]);
    });
    add("of-distance", 96, "from zero", (chart) => {
      const { track, theme } = this;
      if (!track) return;
      const lines = Array.from({ length: track.opponents }, (_, k) => ({
        label: "d_opp", colour: theme.opponent, values: track.columns.get(`op${k}_d`)!,
      }));
      chart.show(rows(track), lines, theme, [
        make("b", "d_opp"), key("centre to centre, half-lengths", theme.opponent),
        key(`near zone, below ${track.corridor.near_distance}`, theme.muted, [4]),
      ]);
    }, () => [{ value: this.track?.corridor.near_distance ?? 0.2, colour: this.theme.muted, fillBelow: true }]);
    add("of-action", 96, [-1.1, 1.1], (chart) => {
      const { track, theme } = this;
      if (!track) return;
      chart.show(rows(track), [
        { label: "x", colour: theme["action-x"], values: track.columns.get("a_x")!, stepped: true },
        { label: "z", colour: theme["action-z"], values: track.columns.get("a_z")!, stepped: true, dash: [6, 3] },
      ], theme, [make("b", "action"), key("along, x", theme["action-x"]), key("across, z", theme["action-z"], [6, 3])]);
    });
  }

  private drawCharts(): void {
    if (this.track) for (const { chart, draw } of this.charts) draw(chart);
  }
}

function rows(track: Track): Float64Array {
  return Float64Array.from({ length: track.rows }, (_, row) => row);
}

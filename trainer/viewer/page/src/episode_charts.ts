// An episode's charts over time: reward, value, curiosity, distance and action; of a second run, the same lines dashed.

import { Chart, Line, key } from "./charts";
import { Track, element, make, seconds } from "./data";
import { Theme } from "./theme";

type Column = "reward" | "value" | "intrinsic" | "op0_d" | "a_x";
interface Panel {
  name: string;
  title: string;
  needs: Column;
  chart: Chart;
  draw: (track: Track, beside: Track | null, theme: Theme) => void;
}

const DASHED = [5, 4];

export class EpisodeCharts {
  private readonly panels: Panel[] = [];
  private track: Track | null = null;
  private theme: Theme | null = null;

  constructor(onSeek: (row: number) => void) {
    const add = (
      name: string, title: string, needs: Column, height: number,
      options: { range?: [number, number]; fromZero?: boolean; levels?: () => { value: number; colour: string; fillBelow?: boolean }[] },
      draw: (chart: Chart, track: Track, beside: Track | null, theme: Theme) => void,
    ) => {
      const box = make("div", "", { className: name });
      element("charts").append(box);
      const chart = new Chart(box, {
        height,
        range: options.range,
        fromZero: options.fromZero,
        // Only whole decisions have a time.
        x: (row) => (Number.isInteger(row) && this.track ? `${+seconds(row, this.track.corridor.decision_seconds)} s` : ""),
        onSeek: (row) => onSeek(Math.round(row)),
        get levels() {
          return options.levels?.() ?? [];
        },
      });
      this.panels.push({ name, title, needs, chart, draw: (track, beside, theme) => draw(chart, track, beside, theme) });
    };
    const both = (track: Track, beside: Track | null, column: string, line: Omit<Line, "values">): Line[] => [
      { ...line, values: track.columns.get(column)! },
      ...(beside?.columns.has(column) ? [{ ...line, values: beside.columns.get(column)!, dash: DASHED }] : []),
    ];
    const second = (beside: Track | null, colour: string) => (beside ? [key("run beside", colour, DASHED)] : []);

    add("of-reward", "reward", "reward", 112, {}, (chart, track, beside, theme) => {
      chart.show(rows(track, beside), [
        { label: "return", colour: theme.muted, values: track.returns, width: 1.4 },
        ...(beside ? [{ label: "return", colour: theme.muted, values: beside.returns, width: 1.4, dash: DASHED }] : []),
        { label: "reward", colour: theme["learner-text"], values: track.columns.get("reward")!, stepped: true },
      ], theme, [make("b", "reward"), key("each decision", theme["learner-text"]), key("return so far", theme.muted), ...second(beside, theme.muted)]);
    });
    add("of-value", "value", "value", 84, {}, (chart, track, beside, theme) => {
      chart.show(rows(track, beside), both(track, beside, "value", { label: "value", colour: theme["action-x"] }), theme,
        [make("b", "value"), key("the return that the critic expects from here on", theme["action-x"]), ...second(beside, theme["action-x"])]);
    });
    add("of-curiosity", "curiosity", "intrinsic", 84, { fromZero: false }, (chart, track, beside, theme) => {
      chart.show(rows(track, beside), both(track, beside, "intrinsic", { label: "c · r_i", colour: theme["switch-text"] }), theme,
        [make("b", "c · r_i"), key("curiosity's reward for each decision, had it been added", theme["switch-text"]), ...second(beside, theme["switch-text"])]);
    });
    add("of-distance", "distance to the opponent", "op0_d", 96, {
      fromZero: true,
      levels: () => [{ value: this.track?.corridor.near_distance ?? 0.2, colour: this.theme?.muted ?? "", fillBelow: true }],
    }, (chart, track, beside, theme) => {
      const colour = theme["opponent-text"];
      const lines = Array.from({ length: track.opponents }, (_, k) => both(track, beside, `op${k}_d`, { label: "d_opp", colour }));
      chart.show(rows(track, beside), lines.flat(), theme, [
        make("b", "d_opp"), key("centre to centre, half-lengths", colour),
        key(`near zone, below ${track.corridor.near_distance}`, theme.muted, [4]), ...second(beside, colour),
      ]);
    });
    add("of-action", "action", "a_x", 96, { range: [-1.1, 1.1] }, (chart, track, beside, theme) => {
      chart.show(rows(track, beside), [
        { label: "x", colour: theme["action-x"], values: track.columns.get("a_x")!, stepped: true },
        { label: "z", colour: theme["action-z"], values: track.columns.get("a_z")!, stepped: true, dash: [6, 3] },
      ], theme, [make("b", "action"), key("along, x", theme["action-x"]), key("across, z", theme["action-z"], [6, 3])]);
    });
  }

  draw(track: Track, beside: Track | null, theme: Theme): void {
    this.track = track;
    this.theme = theme;
    for (const panel of this.panels) {
      panel.chart.home.hidden = !track.columns.has(panel.needs);
      if (panel.chart.home.hidden) continue;
      panel.draw(track, beside, theme);
      const canvas = panel.chart.home.querySelector("canvas");
      canvas?.setAttribute("role", "img");
      canvas?.setAttribute("aria-label", `Chart of ${panel.title} over time; the numbers at the time shown are above`);
    }
  }

  moveHead(time: number): void {
    for (const { chart } of this.panels) chart.moveHead(time);
  }
}

function rows(track: Track, beside: Track | null): Float64Array {
  return Float64Array.from({ length: Math.max(track.rows, beside?.rows ?? 0) }, (_, row) => row);
}

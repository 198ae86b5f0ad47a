// The paper's Fig. 4(b): the corridor from above, x to the right and z upwards.

import { Track } from "./data";
import { Theme } from "./theme";

const WALL = 0.3; // m, as in corridor_server/corridor/drawing.py

export class TopView {
  private readonly context: CanvasRenderingContext2D;

  constructor(private readonly canvas: HTMLCanvasElement) {
    this.context = canvas.getContext("2d")!;
  }

  // ghost: another way through the same episode, shown faintly at the same time.
  draw(track: Track, time: number, theme: Theme, ghost: Track | null): void {
    const { canvas, context: g } = this;
    const ratio = window.devicePixelRatio || 1;
    const width = Math.round(canvas.clientWidth * ratio);
    const height = Math.round(canvas.clientHeight * ratio);
    if (!width || !height) return;
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    const c = track.corridor;
    const scale = Math.min(width / (2 * c.half_length + 4 * WALL), height / (2 * c.half_width + 4 * WALL));
    g.setTransform(1, 0, 0, 1, 0, 0);
    g.clearRect(0, 0, width, height);
    g.setTransform(scale, 0, 0, -scale, width / 2, height / 2);
    const pixel = ratio / scale;
    const row = Math.min(Math.floor(time), track.rows - 1);

    g.fillStyle = theme.wall;
    g.fillRect(-c.half_length - WALL, -c.half_width - WALL, 2 * (c.half_length + WALL), 2 * (c.half_width + WALL));
    g.fillStyle = theme.floor;
    g.fillRect(-c.half_length, -c.half_width, 2 * c.half_length, 2 * c.half_width);

    const on = track.at("switch", row) > 0.5;
    if (c.switch) {
      const { x, z, radius } = c.switch;
      this.disc(x, z, radius, theme.switch, on ? 0.85 : 0.12);
      this.ring(x, z, radius, theme["switch-text"], 2 * pixel);
      this.label(on ? ["switch", "on"] : ["switch", "off"], x, z, radius, on ? "#10231c" : theme.text, pixel);
    }
    const targetSize = c.opponent_radius;
    for (const [x, z] of track.targets ?? []) this.block(x, z, targetSize, theme.opponent);
    const [goalX, goalZ] = track.goal;
    this.block(goalX, goalZ, c.agent_radius, theme.learner);
    this.ring(goalX, goalZ, c.goal_radius, theme["learner-text"], 1.5 * pixel);

    const near = c.near_distance * c.half_length;
    for (let k = 0; k < track.opponents; k++) {
      const [x, z] = track.place(`op${k}`, time);
      const inside = track.at(`op${k}_d`, row) < c.near_distance;
      this.disc(x, z, near, theme.opponent, inside ? 0.3 : 0.09);
      this.ring(x, z, near, theme.opponent, 1.2 * pixel, [4 * pixel, 3 * pixel]);
    }
    for (let k = 0; k < track.opponents; k++) this.trail(track, `op${k}`, time, theme.opponent, pixel);
    if (ghost) {
      const at = Math.min(time, ghost.rows - 1);
      this.trail(ghost, "p", at, theme["learner-text"], pixel, [5 * pixel, 4 * pixel]);
      this.ring(...ghost.place("p", at), c.agent_radius, theme["learner-text"], 2 * pixel, [3 * pixel, 2 * pixel]);
    }
    this.trail(track, "p", time, theme["learner-text"], pixel);
    for (let k = 0; k < track.opponents; k++) {
      const [x, z] = track.place(`op${k}`, time);
      this.disc(x, z, c.opponent_radius, theme.opponent, 1);
    }
    const [x, z] = track.place("p", time);
    this.disc(x, z, c.agent_radius, theme.learner, 1);
    this.ring(x, z, c.agent_radius, theme["learner-text"], 1.5 * pixel);
    if (row + 1 < track.rows || track.outcome === null)
      this.arrow(x, z, c.agent_radius, track.at("a_x", Math.min(row + 1, track.rows - 1)), track.at("a_z", Math.min(row + 1, track.rows - 1)), theme.text, pixel);
  }

  private disc(x: number, z: number, radius: number, colour: string, opacity: number): void {
    const g = this.context;
    g.globalAlpha = opacity;
    g.fillStyle = colour;
    g.beginPath();
    g.arc(x, z, radius, 0, 2 * Math.PI);
    g.fill();
    g.globalAlpha = 1;
  }

  private ring(x: number, z: number, radius: number, colour: string, width: number, dash: number[] = []): void {
    const g = this.context;
    g.strokeStyle = colour;
    g.lineWidth = width;
    g.setLineDash(dash);
    g.beginPath();
    g.arc(x, z, radius, 0, 2 * Math.PI);
    g.stroke();
    g.setLineDash([]);
  }

  private block(x: number, z: number, half: number, colour: string): void {
    const g = this.context;
    g.globalAlpha = 0.5;
    g.fillStyle = colour;
    g.fillRect(x - half, z - half, 2 * half, 2 * half);
    g.globalAlpha = 1;
  }

  private trail(track: Track, name: string, time: number, colour: string, pixel: number, dash: number[] = []): void {
    const g = this.context;
    const scale = track.corridor.half_length;
    const xs = track.columns.get(`${name}_x`)!;
    const zs = track.columns.get(`${name}_z`)!;
    g.strokeStyle = colour;
    g.globalAlpha = 0.75;
    g.lineWidth = 2 * pixel;
    g.lineJoin = "round";
    g.setLineDash(dash);
    g.beginPath();
    g.moveTo(xs[0] * scale, zs[0] * scale);
    for (let row = 1; row <= time && row < track.rows; row++) g.lineTo(xs[row] * scale, zs[row] * scale);
    g.lineTo(...track.place(name, time));
    g.stroke();
    g.setLineDash([]);
    g.globalAlpha = 1;
  }

  // The action, from the learner's rim: the velocity that it wants.
  private arrow(x: number, z: number, radius: number, ax: number, az: number, colour: string, pixel: number): void {
    const length = Math.hypot(ax, az);
    if (length < 0.05) return;
    const g = this.context;
    const reach = 1.3;
    g.strokeStyle = colour;
    g.lineWidth = 1.8 * pixel;
    g.lineCap = "round";
    g.beginPath();
    const [beginX, beginZ] = [x + (radius * ax) / length, z + (radius * az) / length];
    g.moveTo(beginX, beginZ);
    const [tipX, tipZ] = [beginX + reach * ax, beginZ + reach * az];
    g.lineTo(tipX, tipZ);
    for (const turn of [2.6, -2.6]) {
      const angle = Math.atan2(az, ax) + turn;
      g.moveTo(tipX, tipZ);
      g.lineTo(tipX + 0.25 * Math.cos(angle), tipZ + 0.25 * Math.sin(angle));
    }
    g.stroke();
    g.lineCap = "butt";
  }

  // Text in the middle of a disc.
  private label(lines: string[], x: number, z: number, radius: number, colour: string, pixel: number): void {
    const g = this.context;
    const size = Math.min(13, (0.52 * radius) / pixel);
    g.save();
    g.translate(x, z);
    g.scale(pixel, -pixel);
    g.fillStyle = colour;
    g.font = `${size}px system-ui, "Segoe UI", Roboto, "DejaVu Sans", sans-serif`;
    g.textAlign = "center";
    g.textBaseline = "middle";
    lines.forEach((line, i) => g.fillText(line, 0, (i - (lines.length - 1) / 2) * 1.15 * size));
    g.restore();
  }
}

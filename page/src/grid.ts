// Grid and scale of a section: lines of equal distance from the path and of equal elevation, with numbers at the edges.

import type { Cloud } from "./cloud";
import { el } from "./dom";
import type { Model, Place } from "./model";

const LEAST = 55; // pixels between two lines
const MOST = 60; // lines in a direction

export class SectionGrid {
  readonly canvas: HTMLCanvasElement;
  /** Distance of two lines, metres; 0 while there is no section. */
  step = 0;

  constructor(
    private readonly model: Model,
    private readonly cloud: Cloud,
  ) {
    this.canvas = el("canvas", { class: "grid", "aria-label": "Grid of the section" });
    cloud.host.append(this.canvas);
    model.on(["tool", "theme"], () => this.draw());
  }

  draw(): void {
    const { section } = this.model;
    const { clientWidth: width, clientHeight: height } = this.cloud.host;
    this.canvas.hidden = section === null;
    this.step = 0;
    if (!section) return;
    this.canvas.width = width * devicePixelRatio;
    this.canvas.height = height * devicePixelRatio;
    const context = this.canvas.getContext("2d")!;
    context.scale(devicePixelRatio, devicePixelRatio);
    const [x, y] = section.place;
    const base = this.cloud.target[2];
    /** Place at a distance to the right of the path and at a local height. */
    const at = (across: number, z: number) => this.cloud.project([x + Math.cos(section.heading) * across, y - Math.sin(section.heading) * across, z] as Place);
    const [centre, right, up] = [at(0, base), at(1, base), at(0, base + 1)];
    if (!centre || !right || !up) return;
    const metre = Math.max(Math.hypot(right.x - centre.x, right.y - centre.y), Math.hypot(up.x - centre.x, up.y - centre.y));
    this.step = nice(LEAST / metre);
    const reach = Math.min(Math.ceil(Math.hypot(width, height) / metre / this.step), MOST / 2) * this.step;
    const elevation = this.model.survey.origin[2];
    const low = Math.ceil((base + elevation - reach) / this.step) * this.step - elevation;
    context.strokeStyle = context.fillStyle = getComputedStyle(document.body).getPropertyValue("--ink");
    context.font = "12px system-ui, sans-serif";
    context.lineWidth = 1;
    for (let across = -reach; across <= reach + 1e-6; across += this.step) {
      line(context, at(across, base - reach), at(across, base + reach), Math.abs(across) < 1e-6);
      const mark = at(across, base);
      if (mark && mark.x > 60 && mark.x < width - 30) label(context, number(across, this.step), mark.x + 3, height - 8);
    }
    for (let z = low; z <= base + reach; z += this.step) {
      line(context, at(-reach, z), at(reach, z), false);
      const mark = at(0, z);
      if (mark && mark.y > 60 && mark.y < height - 24) label(context, number(z + elevation, this.step), 6, mark.y - 3);
    }
    const text = `Grid ${this.step} m: distance from the path, to the right positive; elevation`;
    label(context, text, width - context.measureText(text).width - 12, height - 26);
    const bar = this.step * metre;
    context.globalAlpha = 1;
    context.lineWidth = 3;
    context.beginPath();
    context.moveTo(width - 12 - bar, height - 46);
    context.lineTo(width - 12, height - 46);
    context.stroke();
    label(context, `${this.step} m`, width - 12 - bar, height - 52);
  }
}

/** Smallest of 1, 2, 5 times a power of ten that is at least a value. */
export function nice(value: number): number {
  const power = 10 ** Math.floor(Math.log10(value));
  const step = [1, 2, 5, 10].find((factor) => factor * power >= value * (1 - 1e-9))! * power;
  return Number(step.toPrecision(1));
}

function number(value: number, step: number): string {
  return value.toFixed(Math.max(0, -Math.floor(Math.log10(step)))).replace(/^-(0\.?0*)$/, "$1");
}

type Seen = { x: number; y: number } | null;

function line(context: CanvasRenderingContext2D, a: Seen, b: Seen, strong: boolean): void {
  if (!a || !b) return;
  context.globalAlpha = strong ? 0.55 : 0.2;
  context.beginPath();
  context.moveTo(a.x, a.y);
  context.lineTo(b.x, b.y);
  context.stroke();
}

function label(context: CanvasRenderingContext2D, text: string, x: number, y: number): void {
  context.globalAlpha = 0.9;
  context.fillText(text, x, y);
}

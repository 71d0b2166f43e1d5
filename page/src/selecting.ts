// Rectangle or lasso on the map: what lies in it is marked.

import { el } from "./dom";
import type { Model } from "./model";

export type Shape = "rectangle" | "lasso";
type Plan = [number, number];

export class Selecting {
  /** Shape that the next drag draws; null moves the map. */
  shape: Shape | null = null;
  /** Places of the drag in local coordinates. */
  private outline: Plan[] = [];
  readonly buttons: HTMLButtonElement[];

  constructor(private readonly model: Model) {
    const button = (shape: Shape, text: string, title: string) =>
      el("button", { type: "button", title, "aria-label": title, "aria-pressed": "false", "data-shape": shape, click: () => this.toggle(shape) }, text);
    this.buttons = model.source.readOnly ? [] : [
      button("rectangle", "▭", "Mark what lies in a rectangle (Shift adds)"),
      button("lasso", "◯", "Mark what lies in a lasso (Shift adds)"),
    ];
  }

  private toggle(shape: Shape): void {
    this.shape = this.shape === shape ? null : shape;
    for (const button of this.buttons) button.setAttribute("aria-pressed", String(button.dataset.shape === this.shape));
  }

  start(place: Plan): void {
    this.outline = [place];
  }

  move([x, y]: Plan): void {
    const [first] = this.outline;
    if (this.shape === "lasso") this.outline.push([x, y]);
    else this.outline = [first, [x, first[1]], [x, y], [first[0], y]];
  }

  /** Closed outline that is being drawn. */
  get drawn(): Plan[] {
    return this.outline;
  }

  /** Mark the shown objects, or the lines with a vertex, inside of the outline. */
  end(add: boolean): void {
    const { model, outline } = this;
    this.outline = [];
    const { origin } = model.survey;
    const ids =
      model.list === "lines"
        ? model.lines.filter((line) => model.shownLine(line) && line.vertices.some(([x, y]) => inside(outline, [x - origin[0], y - origin[1]]))).map((line) => line.line_id)
        : model.objects.filter((object) => model.shown(object) && inside(outline, [object.place[0], object.place[1]])).map((object) => object.id);
    model.setMarked(ids, add);
  }
}

/** Whether a place is in a polygon, by the number of edges to its right. */
export function inside(ring: Plan[], [x, y]: Plan): boolean {
  let odd = false;
  ring.forEach(([x0, y0], i) => {
    const [x1, y1] = ring[(i + 1) % ring.length];
    if (y0 > y !== y1 > y && x < x0 + ((y - y0) / (y1 - y0)) * (x1 - x0)) odd = !odd;
  });
  return odd;
}

// Map of path and objects, drawn without a network; it moves with the cloud.

import { Background } from "./background";
import { channels, classColour, kindColour, lineColour, STATUS_COLOURS } from "./colours";
import type { Cloud } from "./cloud";
import { el } from "./dom";
import type { Model, RoadObject } from "./model";
import { Selecting } from "./selecting";
import type { Entry, RoadLine } from "./types";

/** Box of an object in plan, world coordinates. */
function boxRing({ cells }: RoadObject): [number, number][] | undefined {
  const [left, right, low, high] = [cells.x_min, cells.x_max, cells.y_min, cells.y_max];
  if (typeof left !== "number" || typeof right !== "number" || typeof low !== "number" || typeof high !== "number") return undefined;
  return [[left, low], [right, low], [right, high], [left, high]];
}

export class SurveyMap {
  readonly element: HTMLElement;
  private readonly canvas: HTMLCanvasElement;
  private scale = 1; // pixels per metre
  private centre: [number, number] = [0, 0];
  private drag: { x: number; y: number; moved: number } | null = null;
  private points: { picture: HTMLCanvasElement; low: [number, number]; metres: number } | null = null;
  readonly background: Background | null;
  readonly selecting: Selecting;
  private readonly small: { parent: Element; before: Element | null } = { parent: document.body, before: null };
  private waiting = false;

  constructor(
    private readonly model: Model,
    private readonly cloud: Cloud,
    private readonly pick: (id: number) => void,
    private readonly pickLine: (line: RoadLine) => void,
    private readonly pickEntry: (entry: Entry) => void,
  ) {
    this.selecting = new Selecting(model);
    this.background = model.survey.background ? new Background(model.source, () => this.draw()) : null;
    this.canvas = el("canvas", { tabindex: 0, "aria-label": "Map of the objects. It moves with the cloud." });
    const button = (text: string, label: string, act: () => void) =>
      el("button", { type: "button", title: label, "aria-label": label, click: act }, text);
    this.element = el(
      "section",
      { class: "map" },
      this.canvas,
      el(
        "div",
        { class: "map-buttons" },
        button("+", "Zoom in on the map", () => this.zoom(1.5)),
        button("−", "Zoom out of the map", () => this.zoom(1 / 1.5)),
        button("All", "Show the whole map", () => this.fit()),
        button("⤢", "Larger map (G)", () => this.toggleSize()),
        ...this.selecting.buttons,
        this.background && button("Background", `Show ${model.survey.background} or the points`, () => this.toggleBackground()),
      ),
    );
    this.canvas.addEventListener("pointerdown", (event) => this.down(event));
    this.canvas.addEventListener("pointermove", (event) => this.move(event));
    this.canvas.addEventListener("pointerup", (event) => this.up(event));
    this.canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.zoom(Math.exp(-event.deltaY / 400));
    }, { passive: false });
    new ResizeObserver(() => this.fit()).observe(this.element);
    model.on(["filter", "decisions", "selection", "view", "theme", "tool", "marked", "queue"], () => this.draw());
  }

  private toggleBackground(): void {
    this.background!.shown = !this.background!.shown;
    this.draw();
  }

  /** Show the map below the cloud, in its full width, or back at the upper right. */
  toggleSize(): void {
    const app = document.getElementById("app")!;
    const larger = app.classList.toggle("large-map");
    if (larger) {
      Object.assign(this.small, { parent: this.element.parentElement, before: this.element.nextElementSibling });
      app.append(this.element);
    } else this.small.parent.insertBefore(this.element, this.small.before);
  }

  /** Draw points, x, y, z each, under the objects. */
  setPoints(places: Float32Array, codes: Uint8Array): void {
    const [least, most] = this.model.survey.first.bounds;
    const area = (most[0] - least[0]) * (most[1] - least[1]);
    const metres = Math.max(0.25, Math.max(most[0] - least[0], most[1] - least[1]) / 1200, Math.sqrt(area / Math.max(1, codes.length)));
    const width = Math.ceil((most[0] - least[0]) / metres) + 1;
    const height = Math.ceil((most[1] - least[1]) / metres) + 1;
    const picture = el("canvas", { width, height });
    const context = picture.getContext("2d")!;
    const image = context.createImageData(width, height);
    const tops = new Float32Array(width * height).fill(-Infinity);
    for (let i = 0; i < codes.length; i++) {
      const column = Math.round((places[3 * i] - least[0]) / metres);
      const row = height - 1 - Math.round((places[3 * i + 1] - least[1]) / metres);
      const at = row * width + column;
      if (column < 0 || row < 0 || column >= width || row >= height || places[3 * i + 2] <= tops[at]) continue;
      tops[at] = places[3 * i + 2];
      image.data.set([...channels(classColour(codes[i])), 255], 4 * at);
    }
    context.putImageData(image, 0, 0);
    this.points = { picture, low: [least[0], least[1]], metres };
    this.draw();
  }

  fit(): void {
    const [low, high] = this.model.area();
    const ratio = devicePixelRatio;
    const { clientWidth: width, clientHeight: height } = this.element;
    if (!width || !height) return;
    this.canvas.width = width * ratio;
    this.canvas.height = height * ratio;
    this.scale = 0.92 * Math.min(width / Math.max(1, high[0] - low[0]), height / Math.max(1, high[1] - low[1]));
    this.centre = [(low[0] + high[0]) / 2, (low[1] + high[1]) / 2];
    this.whole = true;
    this.draw();
  }

  private whole = true;

  zoom(factor: number): void {
    this.scale = Math.min(200, Math.max(0.005, this.scale * factor));
    this.whole = false;
    this.draw();
  }

  draw(): void {
    if (this.waiting) return;
    this.waiting = true;
    requestAnimationFrame(() => {
      this.waiting = false;
      this.paint();
    });
  }

  private at(x: number, y: number): [number, number] {
    return [
      (x - this.centre[0]) * this.scale + this.element.clientWidth / 2,
      this.element.clientHeight / 2 - (y - this.centre[1]) * this.scale,
    ];
  }

  private world(event: MouseEvent): [number, number] {
    const box = this.canvas.getBoundingClientRect();
    return [
      (event.clientX - box.x - box.width / 2) / this.scale + this.centre[0],
      (box.height / 2 - (event.clientY - box.y)) / this.scale + this.centre[1],
    ];
  }

  private paint(): void {
    const context = this.canvas.getContext("2d")!;
    const { model } = this;
    const style = getComputedStyle(document.body);
    const ink = style.getPropertyValue("--ink").trim();
    if (!this.whole) this.centre = [this.cloud.target[0], this.cloud.target[1]];
    context.setTransform(devicePixelRatio, 0, 0, devicePixelRatio, 0, 0);
    context.fillStyle = style.getPropertyValue("--panel").trim();
    context.fillRect(0, 0, this.element.clientWidth, this.element.clientHeight);
    const drawn = this.drawBackground(context);
    if (this.points && !drawn) {
      const { picture, low, metres } = this.points;
      const [left, bottom] = this.at(low[0] - metres / 2, low[1] - metres / 2);
      const size = metres * this.scale;
      context.globalAlpha = 0.55;
      context.imageSmoothingEnabled = size < 1;
      context.drawImage(picture, left, bottom - picture.height * size, picture.width * size, picture.height * size);
      context.globalAlpha = 1;
    }
    this.line(context, model.survey.path.map(([x, y]) => this.at(x - model.survey.origin[0], y - model.survey.origin[1])), "#2b8be0", 2);
    const { origin } = model.survey;
    for (const line of model.lines) {
      const chosen = line === model.line || (model.list === "lines" && model.marked.has(line.line_id));
      if (!chosen && (model.lineStatus(line) === "rejected" || !model.shownLine(line))) continue;
      this.line(context, line.vertices.map(([x, y]) => this.at(x - origin[0], y - origin[1])), chosen ? "#ffd21f" : lineColour(line.kind), chosen ? 3 : 1);
    }
    this.objects(context, ink);
    this.camera(context);
    this.bar(context, ink);
    context.setLineDash([5, 4]);
    this.line(context, this.selecting.drawn.map(([x, y]) => this.at(x, y)), "#ffd21f", 1.5, true);
    context.setLineDash([]);
  }

  /** Draw the orthophoto or tiles; true where there are some. */
  private drawBackground(context: CanvasRenderingContext2D): boolean {
    const { background, centre, scale } = this;
    if (!background?.shown) return false;
    const { origin } = this.model.survey;
    const half = [this.element.clientWidth / 2 / scale, this.element.clientHeight / 2 / scale];
    const [x, y] = [centre[0] + origin[0], centre[1] + origin[1]];
    const sheet = background.at([x - half[0], y - half[1], x + half[0], y + half[1]], scale * devicePixelRatio);
    if (!sheet) return false;
    const [left, bottom] = this.at(sheet.area[0] - origin[0], sheet.area[1] - origin[1]);
    const [right, top] = this.at(sheet.area[2] - origin[0], sheet.area[3] - origin[1]);
    context.drawImage(sheet.picture, left, top, right - left, bottom - top);
    return true;
  }

  private line(context: CanvasRenderingContext2D, places: [number, number][], colour: string, width: number, closed = false): void {
    if (places.length < 2) return;
    context.beginPath();
    places.forEach(([x, y], i) => (i ? context.lineTo(x, y) : context.moveTo(x, y)));
    if (closed) context.closePath();
    context.strokeStyle = colour;
    context.lineWidth = width;
    context.stroke();
  }

  private objects(context: CanvasRenderingContext2D, ink: string): void {
    const { model } = this;
    const { origin, footprints } = model.survey;
    for (const object of model.objects) {
      if (!model.shown(object)) continue;
      const [x, y] = this.at(object.place[0], object.place[1]);
      if (x < -20 || y < -20 || x > this.element.clientWidth + 20 || y > this.element.clientHeight + 20) continue;
      const status = model.status(object.id);
      const colour = model.view === "status" ? STATUS_COLOURS[status] : kindColour(object.kind, model.kinds);
      const ring = object.changed ? boxRing(object) : footprints[String(object.id)];
      if (ring && this.scale > 4) this.line(context, ring.map(([a, b]) => this.at(a - origin[0], b - origin[1])), colour, 1, true);
      const radius = object.id === model.selected ? 7 : 4.5;
      context.beginPath();
      if (object.kind === "sign" || object.kind === "vehicle") context.rect(x - radius, y - radius, 2 * radius, 2 * radius);
      else context.arc(x, y, radius, 0, 2 * Math.PI);
      context.fillStyle = colour;
      context.globalAlpha = status === "rejected" ? 0.3 : 1;
      context.fill();
      const marked = object.id === model.selected || (model.list !== "lines" && model.marked.has(object.id));
      context.lineWidth = marked ? 3 : 1;
      context.strokeStyle = marked ? "#ffd21f" : ink;
      context.stroke();
      context.globalAlpha = 1;
    }
    this.entries(context);
    if (!model.entry) return;
    const [x, y] = this.plan(model.entry);
    context.beginPath();
    context.arc(x, y, 10, 0, 2 * Math.PI);
    context.lineWidth = 3;
    context.strokeStyle = "#ffd21f";
    context.stroke();
  }

  private plan({ x, y }: Entry): [number, number] {
    const { origin } = this.model.survey;
    return this.at(x - origin[0], y - origin[1]);
  }

  /** Draw the listed entries of a compared table: diamonds, full ones where the state was checked. */
  private entries(context: CanvasRenderingContext2D): void {
    const { model } = this;
    for (const entry of model.listedEntries()) {
      const [x, y] = this.plan(entry);
      const colour = kindColour(entry.kind, model.kinds);
      this.line(context, [[x - 7, y], [x, y - 7], [x + 7, y], [x, y + 7]], colour, 2, true);
      if (!model.checked(entry)) continue;
      context.fillStyle = colour;
      context.fill();
    }
  }

  private camera(context: CanvasRenderingContext2D): void {
    const [x, y] = this.at(this.cloud.target[0], this.cloud.target[1]);
    const { section } = this.model;
    if (section) {
      const reach = 25;
      const across = [Math.cos(section.heading) * reach, -Math.sin(section.heading) * reach];
      this.line(context, [this.at(section.place[0] - across[0], section.place[1] - across[1]), this.at(section.place[0] + across[0], section.place[1] + across[1])], "#ffb000", 2);
    }
    const length = Math.min(45, Math.max(16, this.cloud.distance * this.scale));
    const { heading } = this.cloud;
    context.beginPath();
    context.moveTo(x - Math.sin(heading) * length, y + Math.cos(heading) * length);
    for (const side of [-0.35, 0.35]) context.lineTo(x + Math.sin(heading + side) * length * 0.25, y - Math.cos(heading + side) * length * 0.25);
    context.closePath();
    context.fillStyle = "rgba(255, 176, 0, 0.35)";
    context.fill();
    context.beginPath();
    context.arc(x, y, 3, 0, 2 * Math.PI);
    context.fillStyle = "#ffb000";
    context.fill();
  }

  private bar(context: CanvasRenderingContext2D, ink: string): void {
    const target = 90 / this.scale;
    const power = 10 ** Math.floor(Math.log10(target));
    const metres = Math.max(...[1, 2, 5].map((step) => step * power).filter((length) => length <= target));
    const y = this.element.clientHeight - 12;
    const x = 12;
    this.line(context, [[x, y - 4], [x, y], [x + metres * this.scale, y], [x + metres * this.scale, y - 4]], ink, 1.5);
    context.fillStyle = ink;
    context.font = "12px system-ui, sans-serif";
    context.fillText(`${metres} m`, x + 4, y - 5);
    const right = this.element.clientWidth - 16;
    context.fillText("N", right - 4, 30);
    this.line(context, [[right - 4, 16], [right, 6], [right + 4, 16]], ink, 1.5);
  }

  private down(event: PointerEvent): void {
    this.drag = { x: event.clientX, y: event.clientY, moved: 0 };
    this.canvas.setPointerCapture(event.pointerId);
    if (this.selecting.shape) this.selecting.start(this.world(event));
  }

  private move(event: PointerEvent): void {
    if (!this.drag) return;
    const [dx, dy] = [event.clientX - this.drag.x, event.clientY - this.drag.y];
    this.drag = { x: event.clientX, y: event.clientY, moved: this.drag.moved + Math.abs(dx) + Math.abs(dy) };
    if (this.drag.moved < 4) return;
    if (this.selecting.shape) {
      this.selecting.move(this.world(event));
      return this.draw();
    }
    const [x, y] = this.cloud.target;
    if (this.whole) this.centre = [this.centre[0] - dx / this.scale, this.centre[1] + dy / this.scale];
    else this.cloud.moveTo(x - dx / this.scale, y + dy / this.scale);
    this.draw();
  }

  private up(event: PointerEvent): void {
    const { drag } = this;
    this.drag = null;
    if (drag && drag.moved >= 4 && this.selecting.shape) this.selecting.end(event.shiftKey);
    if (!drag || drag.moved >= 4) return;
    const [x, y] = this.world(event);
    let best = 10 / this.scale;
    const entry = this.entryAt(x, y, best);
    if (entry) return this.pickEntry(entry);
    let found: number | null = null;
    for (const object of this.model.objects) {
      if (!this.model.shown(object)) continue;
      const distance = Math.hypot(object.place[0] - x, object.place[1] - y);
      if (distance < best) [best, found] = [distance, object.id];
    }
    const line = found === null ? this.lineAt(x, y) : null;
    if (found !== null) this.pick(found);
    else if (line) this.pickLine(line);
    else this.cloud.moveTo(x, y);
  }

  /** Nearest listed entry within a distance. */
  private entryAt(x: number, y: number, reach: number): Entry | undefined {
    const { model } = this;
    const { origin } = model.survey;
    const far = (entry: Entry) => Math.hypot(entry.x - origin[0] - x, entry.y - origin[1] - y);
    return model.listedEntries().filter((entry) => far(entry) < reach).sort((a, b) => far(a) - far(b))[0];
  }

  /** Line within some pixels of a place. */
  private lineAt(x: number, y: number): RoadLine | null {
    const { origin } = this.model.survey;
    let best = 5 / this.scale;
    let found: RoadLine | null = null;
    for (const line of this.model.lines) {
      if (!this.model.shownLine(line) || this.model.lineStatus(line) === "rejected") continue;
      line.vertices.slice(1).forEach((end, i) => {
        const [ax, ay] = [line.vertices[i][0] - origin[0], line.vertices[i][1] - origin[1]];
        const [ux, uy] = [end[0] - origin[0] - ax, end[1] - origin[1] - ay];
        const share = Math.min(1, Math.max(0, ((x - ax) * ux + (y - ay) * uy) / (ux * ux + uy * uy || 1)));
        const apart = Math.hypot(x - ax - share * ux, y - ay - share * uy);
        if (apart < best) [best, found] = [apart, line];
      });
    }
    return found;
  }
}

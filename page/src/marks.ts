// Marks of objects in the cloud: a mast with a dot per object, the box of the selected one, lines of tools.

import * as THREE from "three";

import { kindColour, lineColour, STATUS_COLOURS } from "./colours";
import type { Model, Place, RoadObject } from "./model";
import type { RoadLine } from "./types";

export class Marks {
  readonly group = new THREE.Group();
  private readonly masts = new THREE.LineSegments(new THREE.BufferGeometry(), new THREE.LineBasicMaterial({ vertexColors: true }));
  private readonly dots = new THREE.Points(
    new THREE.BufferGeometry(),
    new THREE.PointsMaterial({ size: 9, sizeAttenuation: false, vertexColors: true, depthTest: false }),
  );
  private readonly box = new THREE.LineSegments(new THREE.BufferGeometry(), new THREE.LineBasicMaterial({ color: "#ffd21f" }));
  private readonly lines = new THREE.LineSegments(
    new THREE.BufferGeometry(),
    new THREE.LineBasicMaterial({ color: "#ffd21f", depthTest: false }),
  );
  private readonly vertices = new THREE.Points(new THREE.BufferGeometry(), new THREE.PointsMaterial({ size: 7, sizeAttenuation: false, color: "#ffd21f", depthTest: false }));
  private readonly path = new THREE.Line(new THREE.BufferGeometry(), new THREE.LineBasicMaterial({ color: "#53b7ff" }));
  readonly brush = new THREE.LineSegments(
    new THREE.WireframeGeometry(new THREE.IcosahedronGeometry(1, 1)),
    new THREE.LineBasicMaterial({ color: "#ffd21f", transparent: true, opacity: 0.6, depthTest: false }),
  );
  /** Lines of the inventory: kerbs and wires. */
  private readonly surveyed = new THREE.Group();
  private tops: { id: number; place: THREE.Vector3 }[] = [];
  /** Drawn lines, each with its colour. */
  private drawn: (RoadLine | string)[] = [];
  visible = true;

  constructor(private readonly model: Model) {
    for (const part of [this.masts, this.dots, this.box, this.lines, this.vertices, this.path, this.brush]) {
      part.frustumCulled = false;
      this.group.add(part);
    }
    this.dots.renderOrder = 2;
    this.lines.renderOrder = 3;
    this.brush.renderOrder = 4;
    this.brush.visible = false;
    const { path, origin } = model.survey;
    this.path.geometry.setFromPoints(path.map(([x, y, z]) => new THREE.Vector3(x - origin[0], y - origin[1], z - origin[2])));
    this.path.visible = path.length > 1;
    this.group.add(this.surveyed);
  }

  /** Draw the lines of the inventory by kind; rejected ones are left out, the chosen one is yellow. */
  private drawLines(): void {
    const { survey, line: chosen, marked, list } = this.model;
    const colourOf = (line: RoadLine) => (line === chosen || (list === "lines" && marked.has(line.line_id)) ? "#ffd21f" : lineColour(line.kind));
    const shown = this.model.lines.filter((line) => line === chosen || (this.model.lineStatus(line) !== "rejected" && this.model.shownLine(line)));
    const drawn = shown.flatMap((line) => [line, colourOf(line)]);
    if (drawn.length === this.drawn.length && drawn.every((part, i) => part === this.drawn[i])) return;
    this.drawn = drawn;
    setPositions(this.vertices.geometry, (chosen?.vertices ?? []).flatMap((vertex) => vertex.map((value, axis) => value - survey.origin[axis])));
    for (const part of this.surveyed.children as THREE.LineSegments[]) part.geometry.dispose();
    this.surveyed.clear();
    for (const colour of new Set(shown.map(colourOf))) {
      const own = shown.filter((line) => colourOf(line) === colour);
      const ends = own.flatMap(({ vertices }) => vertices.slice(1).flatMap((end, i) => [vertices[i], end]));
      const segments = new THREE.LineSegments(new THREE.BufferGeometry(), new THREE.LineBasicMaterial({ color: colour }));
      setPositions(segments.geometry, ends.flatMap((end) => end.map((value, axis) => value - survey.origin[axis])));
      segments.frustumCulled = false;
      this.surveyed.add(segments);
    }
  }

  update(): void {
    const { model } = this;
    const masts: number[] = [];
    const dots: number[] = [];
    const colours: number[] = [];
    const colour = new THREE.Color();
    this.tops = [];
    const add = (place: Place, height: number, name: string): THREE.Vector3 => {
      const top = new THREE.Vector3(place[0], place[1], place[2] + height + 0.6);
      colour.set(name);
      masts.push(...place, ...top.toArray());
      dots.push(...top.toArray());
      colours.push(...colour.toArray());
      return top;
    };
    const { section } = model;
    const beside = ([x, y]: Place) =>
      section !== null &&
      Math.abs((x - section.place[0]) * Math.sin(section.heading) + (y - section.place[1]) * Math.cos(section.heading)) > section.thickness / 2 + 1;
    for (const object of model.objects) {
      if (!model.shown(object) || beside(object.place)) continue;
      const status = model.status(object.id);
      const name = model.list !== "lines" && model.marked.has(object.id) ? "#ffd21f" : model.view === "status" || status === "rejected" ? STATUS_COLOURS[status] : kindColour(object.kind, model.kinds);
      this.tops.push({ id: object.id, place: add(object.place, object.height || 2, name) });
    }
    if (model.entry) add(model.placeOf(model.entry), 3, "#ffd21f");
    setPositions(this.dots.geometry, dots, colours);
    const doubled = Array.from({ length: colours.length / 3 }, (_, i) => [...colours.slice(3 * i, 3 * i + 3), ...colours.slice(3 * i, 3 * i + 3)]).flat();
    setPositions(this.masts.geometry, masts, doubled);
    const chosen = model.selected === null ? undefined : model.byId.get(model.selected);
    this.box.visible = chosen !== undefined;
    if (chosen) setPositions(this.box.geometry, boxLines(this.extent(chosen)));
    this.drawLines();
    this.masts.visible = this.dots.visible = this.visible;
    this.vertices.visible = model.line !== null;
    this.surveyed.visible = this.visible && model.section === null;
    this.path.visible = model.survey.path.length > 1 && model.section === null;
  }

  private extent(object: RoadObject): THREE.Box3 {
    const { origin } = this.model.survey;
    const corner = (end: string) =>
      new THREE.Vector3(...["x", "y", "z"].map((axis, i) => Number(object.cells[`${axis}_${end}`] ?? object.cells[axis]) - origin[i]));
    return new THREE.Box3(corner("min"), corner("max")).expandByScalar(0.05);
  }

  /** Lines of a tool, as pairs of places. */
  setLines(places: Place[]): void {
    setPositions(this.lines.geometry, places.flat());
  }

  place(_camera: THREE.Camera, _height: number): void {
    (this.dots.material as THREE.PointsMaterial).size = this.tops.length > 400 ? 6 : 9;
  }

  near(camera: THREE.PerspectiveCamera, x: number, y: number, width: number, height: number): number | null {
    if (!this.visible) return null;
    let best = 9;
    let found: number | null = null;
    const seen = new THREE.Vector3();
    for (const { id, place } of this.tops) {
      seen.copy(place).project(camera);
      if (seen.z > 1) continue;
      const distance = Math.hypot(((seen.x + 1) / 2) * width - x, ((1 - seen.y) / 2) * height - y);
      if (distance < best) [best, found] = [distance, id];
    }
    return found;
  }
}

function setPositions(geometry: THREE.BufferGeometry, positions: number[], colours?: number[]): void {
  geometry.setAttribute("position", new THREE.Float32BufferAttribute(positions, 3));
  if (colours) geometry.setAttribute("color", new THREE.Float32BufferAttribute(colours, 3));
}

function boxLines(box: THREE.Box3): number[] {
  const { min, max } = box;
  const corner = (i: number) => [i & 1 ? max.x : min.x, i & 2 ? max.y : min.y, i & 4 ? max.z : min.z];
  const edges = [0, 1, 2, 3, 4, 5, 6, 7, 0, 2, 1, 3, 4, 6, 5, 7, 0, 4, 1, 5, 2, 6, 3, 7];
  return edges.flatMap(corner);
}

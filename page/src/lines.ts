// What buttons, keys and clicks do with lines: kerbs, wires, barriers and markings.

import { ask } from "./ask";
import type { Cloud } from "./cloud";
import { lineOrder } from "./listing";
import { LINE_KINDS, type Model, type Place, type Tool } from "./model";
import type { RoadLine, Wanted } from "./types";

const REACH = 12; // of a click, pixels

/** What lines need of the actions. */
interface Host {
  readonly model: Model;
  readonly cloud: Cloud;
  places: Place[];
  tool(tool: Tool): void;
  missed(text: string): void;
}

interface Hit {
  line: RoadLine;
  /** Segment from this vertex to the next one, and the place on it. */
  segment: number;
  place: Place;
}

export class Lines {
  /** Vertex of the chosen line that the next click moves. */
  vertex: number | null = null;

  constructor(private readonly actions: Host) {}

  private get model() {
    return this.actions.model;
  }

  go(line: RoadLine): void {
    this.actions.tool("look");
    this.model.selectLine(line);
    const [x, y, z] = this.local(line.vertices[Math.floor(line.vertices.length / 2)]);
    this.actions.cloud.look([x, y, z], Math.min(40, 8 + line.length), undefined, 0.8);
  }

  next(step: number): void {
    const lines = lineOrder(this.model);
    if (!lines.length) return;
    const here = lines.findIndex(({ line_id }) => line_id === this.model.line?.line_id);
    this.go(lines[here < 0 ? 0 : (here + step + lines.length) % lines.length]);
  }

  /** Decide about a line, and go on to the next one of the list. */
  async decide(line: RoadLine, action: string, more: Record<string, unknown> = {}): Promise<void> {
    const { model } = this;
    if (model.busy) return;
    const lines = lineOrder(model);
    const following = lines[lines.findIndex(({ line_id }) => line_id === line.line_id) + 1];
    const done = await model.decide(this.wanted(line, action, more));
    const next = following && model.lineOf(following.line_id);
    if (done && next && model.line?.line_id === line.line_id) this.go(next);
  }

  wanted({ line_id, kind, x, y }: RoadLine, action: string, more: Record<string, unknown> = {}): Wanted {
    return { action, kind, payload: { line: line_id, x, y, ...more } };
  }

  /** Change the vertices of a line and stay with it. */
  private reshape(line: RoadLine, action: string, parts: Place[][], more: Record<string, unknown> = {}): void {
    this.actions.tool("look");
    void this.model.decide(this.wanted(line, action, { parts, ...more }));
  }

  askKind(line: RoadLine): void {
    const kinds = LINE_KINDS.filter((kind) => kind !== line.kind);
    ask(this.model, `What is ${name(line)}?`, kinds, (to) => void this.decide(line, "kind_line", { to }), false);
  }

  local(vertex: number[]): Place {
    const { origin } = this.model.survey;
    return [vertex[0] - origin[0], vertex[1] - origin[1], vertex[2] - origin[2]];
  }

  private world(place: Place): Place {
    const { origin } = this.model.survey;
    return place.map((value, axis) => Math.round((value + origin[axis]) * 1000) / 1000) as Place;
  }

  /** Line near a place of the window, and the nearest place on it. */
  at(x: number, y: number, lines = this.model.lines.filter((line) => this.model.shownLine(line)), reach = REACH): Hit | null {
    const { cloud } = this.actions;
    const box = cloud.canvas.getBoundingClientRect();
    let best = reach;
    let hit: Hit | null = null;
    for (const line of lines) {
      const places = line.vertices.map((vertex) => this.local(vertex));
      const seen = places.map((place) => cloud.project(place));
      for (let i = 0; i + 1 < seen.length; i++) {
        const [a, b] = [seen[i], seen[i + 1]];
        if (!a || !b) continue;
        const [ux, uy, px, py] = [b.x - a.x, b.y - a.y, x - box.x - a.x, y - box.y - a.y];
        const share = Math.min(1, Math.max(0, (px * ux + py * uy) / (ux * ux + uy * uy || 1)));
        const apart = Math.hypot(px - share * ux, py - share * uy);
        if (apart >= best) continue;
        best = apart;
        hit = { line, segment: i, place: places[i].map((value, axis) => value + share * (places[i + 1][axis] - value)) as Place };
      }
    }
    return hit;
  }

  /** Use a click of a tool for lines; false where it is about something else. */
  click(x: number, y: number, point: Place | null): boolean {
    const { model, actions } = this;
    const { line, tool } = model;
    if (tool === "line") {
      if (point) actions.places = [...actions.places, point];
      else actions.missed("There is no point here: click on a point.");
      return true;
    }
    if (tool === "look" && model.list === "lines") {
      const hit = this.at(x, y);
      if (hit) model.selectLine(hit.line);
      return hit !== null;
    }
    if (!line) return false;
    if (tool === "split") this.cut(line, this.at(x, y, [line]));
    else if (tool === "merge") this.join(line, this.at(x, y, model.lines.filter((other) => other !== line && other.kind === line.kind)));
    else if (tool === "base") this.moveVertex(line, x, y, point);
    else return false;
    return true;
  }

  private cut(line: RoadLine, hit: Hit | null): void {
    if (!hit) return this.actions.missed("The chosen line is not here: click on it.");
    const place = this.world(hit.place);
    const apart = (vertex: Place) => Math.hypot(vertex[0] - place[0], vertex[1] - place[1]);
    const [first, second] = [line.vertices.slice(0, hit.segment + 1), line.vertices.slice(hit.segment + 1)];
    if (apart(first[0]) < 0.01 || apart(second.at(-1)!) < 0.01) return this.actions.missed("This is an end of the line: click between its ends.");
    const parts = [
      [...first.filter((vertex) => apart(vertex) >= 0.01), place],
      [place, ...second.filter((vertex) => apart(vertex) >= 0.01)],
    ];
    this.reshape(line, "cut_line", parts);
  }

  /** Join two lines at their nearest ends; the chosen one keeps its direction. */
  private join(line: RoadLine, hit: Hit | null): void {
    if (!hit) return this.actions.missed(`There is no other ${line.kind.replace("_", " ")} here: click on one.`);
    const { line_id, kind, x, y } = hit.line;
    const [own, other, back] = [line.vertices, hit.line.vertices, [...hit.line.vertices].reverse()];
    const ways = [[own, other], [other, own], [own, back], [back, own]];
    const gap = ([a, b]: Place[][]) => Math.hypot(a.at(-1)![0] - b[0][0], a.at(-1)![1] - b[0][1]);
    const [first, second] = ways.reduce((best, way) => (gap(way) < gap(best) ? way : best));
    const vertices = gap([first, second]) < 0.01 ? [...first, ...second.slice(1)] : [...first, ...second];
    this.reshape(line, "join_lines", [vertices], { other: { line: line_id, kind, x, y } });
  }

  private moveVertex(line: RoadLine, x: number, y: number, point: Place | null): void {
    const { actions, vertex } = this;
    if (vertex === null) {
      const box = actions.cloud.canvas.getBoundingClientRect();
      const apart = line.vertices.map((place) => {
        const seen = actions.cloud.project(this.local(place));
        return seen ? Math.hypot(seen.x + box.x - x, seen.y + box.y - y) : Infinity;
      });
      const nearest = apart.indexOf(Math.min(...apart));
      if (apart[nearest] > REACH) return actions.missed("There is no vertex here: click on one of the crosses.");
      this.vertex = nearest;
      this.model.emit("tool");
      return;
    }
    if (!point) return actions.missed("There is no point here: click on a point.");
    const moved = line.vertices.map((place, i) => (i === vertex ? this.world(point) : place));
    this.reshape(line, "shape_line", [moved]);
  }

  /** End a line that is being drawn. */
  finish(): void {
    const { actions } = this;
    const { places } = actions;
    if (places.length < 2) return actions.missed("A line needs two vertices or more: click each.");
    const parts = [places.map((place) => this.world(place))];
    actions.tool("look");
    ask(this.model, "What is this line?", LINE_KINDS, (kind) => void this.model.decide({ action: "add_line", kind, payload: { parts } }), false);
  }

  /** Segments to draw for the tools: vertices of the chosen line, or the line that is being drawn. */
  drawn(): Place[] {
    const { model, actions } = this;
    if (model.tool === "line") return actions.places.flatMap((place, i) => (i ? [actions.places[i - 1], place] : cross(place, 0.2)));
    if (model.tool !== "base" || !model.line) return [];
    return model.line.vertices.flatMap((vertex, i) => cross(this.local(vertex), i === this.vertex ? 0.5 : 0.2));
  }
}

function cross([x, y, z]: Place, size: number): Place[] {
  return [[x - size, y, z], [x + size, y, z], [x, y - size, z], [x, y + size, z], [x, y, z - size], [x, y, z + size]];
}

export function name(line: RoadLine): string {
  return `${line.kind.replace("_", " ")} ${line.line_id}`;
}

// What buttons and keys do.

import type { Cloud } from "./cloud";
import { ask } from "./ask";
import { Entries } from "./entries";
import { Lines } from "./lines";
import { listing } from "./listing";
import { KINDS, type List, type Model, type Place, type Tool } from "./model";
import { Together } from "./together";
import type { PointGroup, Wanted } from "./types";

const UNCLASSED = new Set([0, 1, 7, 18]); // last in lists of classes

export class Actions {
  /** Places that a tool has collected. */
  places: Place[] = [];
  onPlaces: () => void = () => {};
  readonly lines = new Lines(this);
  readonly entries = new Entries(this);
  private readonly together = new Together(this);
  /** Step that waits for the list. */
  private awaited: number | null = null;

  constructor(
    readonly model: Model,
    readonly cloud: Cloud,
  ) {
    model.on(["queue"], () => {
      const step = this.awaited;
      if (step === null || !model.queued) return;
      this.awaited = null;
      if (model.selected === null) this.next(step);
    });
  }

  go(id: number): void {
    this.tool("look");
    this.model.select(id);
    this.cloud.focus(id);
  }

  goGroup(group: PointGroup): void {
    this.tool("look");
    void this.model.selectGroup(group);
    this.cloud.focusGroup(group.place);
  }

  /** Show the objects or the uncertain places in the list. */
  toggleList(): void {
    this.showList(this.model.list === "groups" ? "objects" : "groups");
  }

  showList(list: List): void {
    const { model } = this;
    if ((list === "lines") !== (model.list === "lines") || model.survey.entries[list]) model.setMarked([]);
    model.set("queue", "list", list);
    model.emit("filter"); // kinds of lines in place of those of objects
    if (list === "groups" && !model.groups.length) void model.loadGroups();
  }

  /** Go to the next object or place of the list, or to the one before. */
  next(step = 1): void {
    const { model } = this;
    if (model.list === "groups") return this.nextGroup(step);
    if (model.list === "lines") return this.lines.next(step);
    if (model.survey.entries[model.list]) return this.entries.next(step);
    if (!model.queued) {
      this.awaited = step;
      return this.hint("The list is being read.", () => !model.queued);
    }
    const ids = this.listed();
    if (!ids.length) return;
    const here = ids.indexOf(model.selected ?? -1);
    this.go(ids[here < 0 ? 0 : (here + step + ids.length) % ids.length]);
  }

  /** Numbers of the objects in the list that can be decided. */
  private listed(): number[] {
    return listing(this.model).filter((object) => !object.made).map((object) => object.id);
  }

  private nextGroup(step = 1): void {
    const { groups, group } = this.model;
    if (!groups.length) return void this.model.loadGroups();
    const here = group === null ? -1 : groups.indexOf(group);
    this.goGroup(groups[here < 0 ? 0 : (here + step + groups.length) % groups.length]);
  }

  /** Write the class of the chosen place, and go on to the next one. */
  async answer(group: PointGroup, name: string): Promise<void> {
    if (this.model.busy) return;
    const { groups } = this.model;
    const following = groups[groups.indexOf(group) + 1];
    const here = this.model.group === group;
    if (!(await this.model.answer(group, name))) return;
    if (this.model.groups.length < 10) await this.model.loadGroups(); // an order that knows the answers
    if (here && this.model.group === null && this.model.groups.length) this.goGroup(this.model.groups.includes(following) ? following : this.model.groups[0]);
  }

  private async leaveOut(group: PointGroup): Promise<void> {
    const { groups } = this.model;
    const following = groups[groups.indexOf(group) + 1];
    await this.model.leaveOut(group);
    if (following && this.model.group === null) this.goGroup(following);
  }

  /** Number of the chosen object that can be decided about; a hint where there is none. */
  private chosen(): number | null {
    const { model } = this;
    const { selected } = model;
    const object = model.byId.get(selected ?? 0);
    if (selected === null) this.hint("Choose an object first: click it, or press N for the next one.", () => model.selected === null);
    else if (object?.made) this.hint(`A decision made ${object.kind} ${selected}: take it back to change it.`, () => model.selected === selected);
    return object && !object.made ? selected : null;
  }

  /** Show a message while it holds. */
  hint(text: string, holds: () => boolean): void {
    this.model.set("saved", "saved", { text, kind: "", holds });
  }

  /** Say that a click of a tool hit nothing. */
  missed(text: string): void {
    const { model, places } = this;
    const { tool } = model;
    this.hint(text, () => model.tool === tool && this.places === places);
  }

  private async decideAndGoOn(wanted: Wanted & { object_id: number }): Promise<void> {
    if (this.model.busy) return; // a second key is for the object that is shown next
    const id = wanted.object_id;
    const ids = this.listed();
    const following = ids[ids.indexOf(id) + 1];
    const inList = ids.includes(id);
    if ((await this.model.decide(wanted)) && inList && following !== undefined && this.model.selected === id) {
      this.go(following);
    }
  }

  /** Take a decision back, by default the last one of this tab, and return to its object. */
  async undo(decision?: number): Promise<void> {
    const undone = await this.model.undo(decision);
    if (undone?.object_id && this.model.byId.has(undone.object_id)) this.go(undone.object_id);
    const line = undone?.line && this.model.lineOf(undone.line);
    if (line) this.lines.go(line);
    const [table, name] = undone?.entry ?? [];
    const entry = table && this.model.entriesOf(table).find((other) => other.name === name);
    if (entry) this.entries.go(entry);
  }

  accept(): void {
    const { entry, group, line, marked } = this.model;
    if (marked.size) return void this.together.decide("accept", "accepted");
    if (entry) return void this.entries.decide(entry, "right");
    if (line) return void this.lines.decide(line, "accept_line");
    if (group) return void this.answer(group, this.model.className(group.code));
    const id = this.chosen();
    if (id !== null) void this.decideAndGoOn({ action: "accept", object_id: id });
  }

  reject(): void {
    if (this.model.marked.size) return void this.together.decide("reject", "rejected");
    if (this.model.entry) return void this.entries.decide(this.model.entry, "wrong");
    if (this.model.line) return void this.lines.decide(this.model.line, "reject_line");
    if (this.model.group) return void this.leaveOut(this.model.group);
    const id = this.chosen();
    if (id !== null) void this.decideAndGoOn({ action: "reject", object_id: id });
  }

  otherKind(): void {
    const { group, line, marked } = this.model;
    if (marked.size) return this.together.askKind();
    if (line) return this.lines.askKind(line);
    if (group) {
      const own = this.model.className(group.code);
      const codes = [...this.model.classNames.keys()].sort((a, b) => Number(UNCLASSED.has(a)) - Number(UNCLASSED.has(b)) || a - b);
      const names = [...new Set(codes.map((code) => this.model.className(code)))].filter((name) => name !== own);
      return ask(this.model, "What are the marked points?", names, (name, other) => void this.answer(group, name || other));
    }
    const id = this.chosen();
    if (id === null) return;
    const own = this.model.byId.get(id)!.kind;
    ask(this.model, `What is ${own} ${id}?`, KINDS.filter((kind) => kind !== own), (kind, name) => {
      const payload = name ? { class: name } : {};
      void this.decideAndGoOn({ action: "other_kind", object_id: id, ...(kind ? { kind } : {}), payload });
    });
  }

  tool(tool: Tool): void {
    const { model } = this;
    if (["base", "merge", "split"].includes(tool) && !model.line && this.chosen() === null) return;
    if (["base", "merge", "split", "paint", "add", "line"].includes(tool) && model.source.readOnly) {
      this.hint("This page is a copy to look at: it saves nothing.", () => true);
      return;
    }
    if (tool === "paint" && model.tiles.state !== "ready") {
      this.hint("The points are still being prepared; paint when that is finished.", () => model.tiles.state !== "ready");
      return;
    }
    this.places = [];
    this.lines.vertex = null;
    model.set("tool", "tool", tool === model.tool && tool !== "look" ? "look" : tool);
    this.onPlaces();
  }

  /** End a tool; without one, unmark what is marked, else choose nothing. */
  escape(): void {
    const { model } = this;
    if (model.tool !== "look") this.tool("look");
    else if (model.marked.size) model.setMarked([]);
    else model.select(null);
  }

  private world(place: Place): Record<string, number> {
    const { origin } = this.model.survey;
    const rounded = place.map((value, i) => Math.round((value + origin[i]) * 1000) / 1000);
    return { x: rounded[0], y: rounded[1], z: rounded[2] };
  }

  moveBase(place: Place): void {
    const id = this.chosen();
    if (id === null) return;
    this.tool("look");
    void this.model.decide({ action: "move_base", object_id: id, payload: this.world(place) });
  }

  merge(other: number): void {
    const id = this.chosen();
    if (id === null || other === id) return;
    this.tool("look");
    void this.model.decide({ action: "merge", object_id: id, payload: { objects: [other] } });
  }

  add(place: Place): void {
    this.tool("look");
    ask(this.model, "What is missing here?", KINDS, (kind, name) => {
      const payload = { ...this.world(place), ...(name ? { class: name } : {}) };
      void this.model.decide({ action: "add", kind: kind || name, payload });
    });
  }

  /** End a tool that collects places. */
  finish(): void {
    if (this.model.tool === "line") return this.lines.finish();
    if (this.model.tool === "split" && this.places.length > 1) {
      const bases = this.places.map((place) => Object.values(this.world(place)));
      const id = this.model.selected;
      this.tool("look");
      if (id !== null) void this.model.decide({ action: "split", object_id: id, payload: { bases } });
    } else if (this.model.tool === "split") {
      const { model } = this;
      this.hint("A split needs two bases or more: click each.", () => model.tool === "split" && this.places.length < 2);
    }
  }

  // Section across the road

  section(place?: Place): void {
    const { model, cloud } = this;
    if (model.section && !place) {
      model.section = null;
      cloud.look(cloud.target, cloud.distance / 6, cloud.heading, 0.5);
    } else {
      const centre = place ?? cloud.target;
      const heading = model.section && !place ? model.section.heading : this.headingAt(centre);
      model.section = { place: this.onPath(centre), heading, thickness: model.section?.thickness ?? 1 };
      const [x, y] = model.section.place;
      // A narrow field from afar is nearly a parallel projection.
      cloud.look([x, y, centre[2] + 3], 220, heading, 0.02, 8);
    }
    cloud.setSection();
    model.emit("tool");
  }

  private nearest(place: Place): number {
    const { path, origin } = this.model.survey;
    let best = Infinity;
    let found = -1;
    path.forEach(([x, y], i) => {
      const distance = Math.hypot(x - origin[0] - place[0], y - origin[1] - place[1]);
      if (distance < best) [best, found] = [distance, i];
    });
    return found;
  }

  private headingAt(place: Place): number {
    const { path } = this.model.survey;
    const i = this.nearest(place);
    if (i >= 0 && path.length > 1) {
      const [a, b] = [path[Math.max(0, i - 3)], path[Math.min(path.length - 1, i + 3)]];
      return Math.atan2(b[0] - a[0], b[1] - a[1]);
    }
    const [low, high] = this.model.survey.first.bounds;
    return high[0] - low[0] > high[1] - low[1] ? Math.PI / 2 : 0; // the longer side
  }

  private onPath(place: Place): Place {
    const { path, origin } = this.model.survey;
    const i = this.nearest(place);
    if (i < 0) return place;
    return [path[i][0] - origin[0], path[i][1] - origin[1], path[i][2] - origin[2]];
  }

  /** Move the section along the road, or change its thickness. */
  moveSection(metres: number, factor = 1): void {
    const { section } = this.model;
    if (!section) return;
    section.thickness = Math.min(50, Math.max(0.1, section.thickness * factor));
    const [x, y, z] = section.place;
    section.place = [x + Math.sin(section.heading) * metres, y + Math.cos(section.heading) * metres, z];
    if (metres) {
      section.heading = this.model.survey.path.length > 1 ? this.headingAt(section.place) : section.heading;
      const height = this.cloud.target[2];
      this.cloud.look([section.place[0], section.place[1], height], this.cloud.distance, section.heading, this.cloud.rise, this.cloud.camera.fov);
    }
    this.cloud.setSection();
    this.model.emit("tool");
  }
}

// State of the page: survey, filters, selection, decisions. Parts of the page listen to its changes.

import { ServerError, type Source } from "./source";
import type { Added, Cell, Corrections, Decision, ObjectState, Paint, PointGroup, QueueItem, Status, Survey, Wanted } from "./types";

export const VIEWS = ["class", "confidence", "intensity", "height", "colour", "object", "status", "error"] as const;
export type View = (typeof VIEWS)[number];
export type Tool = "look" | "measure" | "section" | "paint" | "base" | "merge" | "split" | "add";
export type List = "objects" | "groups";
export type Change = "view" | "filter" | "selection" | "decisions" | "queue" | "tool" | "status" | "saved" | "paint" | "theme";
export type Place = [number, number, number];

export interface RoadObject {
  id: number;
  kind: string;
  name: string;
  score: number;
  place: Place;
  height: number;
  cells: Record<string, Cell>;
}

export interface PickedPoint {
  place: Place;
  code: number;
  confidence: number;
  reference: number;
  intensity: number;
  object: number;
  row: number;
}

export const STATUSES = ["", "accepted", "rejected", "changed", "moved", "merged", "split"];
export const KINDS = ["pole", "sign", "tree", "vehicle"];

export class Model {
  readonly objects: RoadObject[];
  readonly byId = new Map<number, RoadObject>();
  readonly kinds: string[];
  readonly classNames = new Map<number, string>();
  classCounts = new Map<number, number>();
  view: View = "class";
  hiddenClasses = new Set<number>();
  hiddenKinds = new Set<string>();
  hiddenStatuses = new Set<string>();
  leastScore = 0;
  selected: number | null = null;
  point: PickedPoint | null = null;
  tool: Tool = "look";
  brush = { radius: 0.3, class: "", cluster: false, only: true };
  section: { place: Place; heading: number; thickness: number } | null = null;
  states: Record<string, ObjectState> = {};
  decisions: Decision[] = [];
  added: Added[] = [];
  queue: QueueItem[] = [];
  /** What the list at the right holds: objects, or groups of points that belong to none. */
  list: List = "objects";
  groups: PointGroup[] = [];
  group: PointGroup | null = null;
  /** Rows of the points of the chosen group. */
  highlighted = new Set<number>();
  /** Group that was left out last, until something is saved. */
  private leftOut: PointGroup | null = null;
  painted = new Map<number, number>();
  saved: { text: string; kind: "" | "busy" | "ok" | "bad" } = { text: "", kind: "" };
  tiles: Status = { state: "building", share: 0 };
  private strokes = new Map<number, { ids: number[]; rows: number[]; code: number }>();
  private done: number[][] = [];
  private last: Promise<unknown> = Promise.resolve();
  private waiting = 0;
  private listeners = new Map<Change, (() => void)[]>();

  constructor(
    readonly source: Source,
    readonly survey: Survey,
  ) {
    const { columns, rows } = survey.objects;
    this.objects = rows.map((row) => {
      const cells = Object.fromEntries(columns.map((name, i) => [name, row[i]]));
      const place = [0, 1, 2].map((axis) => Number(cells["xyz"[axis]]) - survey.origin[axis]) as Place;
      return {
        id: Number(cells.object_id),
        kind: String(cells.kind),
        name: String(cells.class),
        score: Number(cells.score),
        place,
        height: Number(cells.height ?? 0),
        cells,
      };
    });
    for (const object of this.objects) this.byId.set(object.id, object);
    this.kinds = [...new Set(this.objects.map((object) => object.kind))].sort();
    for (const [code, name] of Object.entries(survey.classes)) this.classNames.set(Number(code), name);
    const share = survey.n_points / Math.max(1, survey.first.n_points);
    for (const [code, n] of Object.entries(survey.first.classes)) this.classCounts.set(Number(code), Math.round(n * share));
  }

  on(changes: Change[], listener: () => void): void {
    for (const change of changes) this.listeners.set(change, [...(this.listeners.get(change) ?? []), listener]);
  }

  emit(change: Change): void {
    for (const listener of this.listeners.get(change) ?? []) listener();
  }

  set<K extends keyof Model>(change: Change, name: K, value: this[K]): void {
    (this as any)[name] = value;
    this.emit(change);
  }

  /** Part of the survey that was driven and has objects, with some room; all of it where both are unknown. */
  area(): [Place, Place] {
    const [low, high] = this.survey.first.bounds;
    const { path, origin } = this.survey;
    const places = [...this.objects.map((object) => object.place), ...path.map(([x, y, z]) => [x - origin[0], y - origin[1], z - origin[2]])];
    if (places.length < 2) return [low, high];
    const room = 15;
    // Single places far off do not count: if the outer 2 % of each side double the extent, they are left out.
    const skipped = Math.floor(0.02 * places.length);
    const ranges = [0, 1].map((axis) => {
      const sorted = places.map((place) => place[axis]).sort((a, b) => a - b);
      const [all, most] = [0, skipped].map((n) => [sorted[n], sorted[places.length - 1 - n]]);
      return all[1] - all[0] > 2 * (most[1] - most[0] + room) ? most : all;
    });
    const least = ranges.map(([first], axis) => Math.max(low[axis], first - room));
    const most = ranges.map(([, last], axis) => Math.min(high[axis], last + room));
    return [[least[0], least[1], low[2]], [most[0], most[1], high[2]]];
  }

  className(code: number): string {
    return this.classNames.get(code) ?? `class ${code}`;
  }

  codeOf(name: string): number {
    return [...this.classNames].find(([, known]) => known === name)?.[0] ?? 0;
  }

  state(id: number): ObjectState | undefined {
    return this.states[String(id)];
  }

  status(id: number): string {
    return this.state(id)?.status ?? "";
  }

  kindOf(object: RoadObject): string {
    return this.state(object.id)?.checked_kind || object.kind;
  }

  placeOf(object: RoadObject): Place {
    const state = this.state(object.id);
    if (state?.x === undefined || state.y === undefined || state.z === undefined) return object.place;
    const { origin } = this.survey;
    return [state.x - origin[0], state.y - origin[1], state.z - origin[2]];
  }

  shown(object: RoadObject): boolean {
    return (
      !this.hiddenKinds.has(object.kind) &&
      !this.hiddenStatuses.has(this.status(object.id)) &&
      object.score >= this.leastScore
    );
  }

  /** Number of shown objects, and the number of them that are expected to be right. */
  expected(kind?: string): { n: number; right: number } {
    const chosen = this.objects.filter((object) => this.shown(object) && (kind === undefined || object.kind === kind));
    const right = chosen.reduce((sum, object) => sum + this.probability(object), 0);
    return { n: chosen.length, right };
  }

  probability(object: RoadObject): number {
    const status = this.status(object.id);
    return status === "" ? object.score : status === "rejected" ? 0 : 1;
  }

  select(id: number | null, point: PickedPoint | null = null): void {
    this.selected = id;
    this.point = point;
    this.leaveGroup();
    this.emit("selection");
  }

  private leaveGroup(): void {
    this.group = null;
    if (!this.highlighted.size) return;
    this.highlighted = new Set();
    this.emit("paint");
  }

  /** Choose a group of points and mark them. */
  async selectGroup(group: PointGroup): Promise<void> {
    this.select(null);
    this.group = group;
    this.emit("selection");
    try {
      const rows = await this.source.group(group);
      if (this.group !== group) return;
      this.highlighted = new Set(rows);
      this.emit("paint");
      this.emit("selection");
    } catch (error) {
      this.report(error, "The points of this place cannot be read");
    }
  }

  /** Give the points of a group a class, also the one that they have. */
  async answer(group: PointGroup, name: string): Promise<boolean> {
    const done = await this.paint({ places: [group.place], radius: 1, class: name, only: group.code, group: true });
    if (done) this.drop(group);
    return done;
  }

  /** Ask about a group no more while the page is open. */
  async leaveOut(group: PointGroup): Promise<void> {
    try {
      await this.source.leaveOut(group, false);
      this.leftOut = group;
      this.drop(group);
    } catch (error) {
      this.report(error, "Not left out");
    }
  }

  private drop(group: PointGroup): void {
    this.groups = this.groups.filter((other) => other !== group);
    if (this.group === group) this.leaveGroup();
    this.emit("queue");
  }

  async loadGroups(): Promise<void> {
    try {
      this.groups = await this.source.groups(50);
      this.emit("queue");
    } catch (error) {
      this.report(error, "Places cannot be listed");
    }
  }

  async load(): Promise<void> {
    try {
      const found = await this.source.corrections();
      for (const stroke of found.painted) {
        const code = this.codeOf(stroke.class);
        this.strokes.set(stroke.id, { ids: [stroke.id], rows: stroke.rows, code });
        for (const row of stroke.rows) this.painted.set(row, code);
      }
      this.take(found);
      this.emit("paint");
      this.queue = await this.source.queue(100);
      this.emit("queue");
    } catch (error) {
      this.report(error, "Decisions cannot be read");
    }
  }

  private take(found: Corrections): void {
    this.states = found.states;
    this.decisions = found.decisions;
    this.added = found.added;
    this.emit("decisions");
  }

  private async refresh(): Promise<void> {
    this.take(await this.source.states());
    this.queue = await this.source.queue(100);
    this.emit("queue");
  }

  private report(error: unknown, what: string): void {
    const reason = error instanceof ServerError ? error.message : String(error);
    this.saved = { text: `${what}: ${reason}`, kind: "bad" };
    this.emit("saved");
  }

  private say(text: string, kind: "busy" | "ok"): void {
    this.saved = { text, kind };
    this.emit("saved");
  }

  /** Whether an answer is awaited; the lists and the next object are not shown yet. */
  get busy(): boolean {
    return this.waiting > 0;
  }

  /** Send a decision; true once the server has it on disk. */
  async decide(wanted: Wanted): Promise<boolean> {
    return this.save(async () => {
      const { ids } = await this.source.decide(wanted);
      this.done.push(ids);
      return "Saved";
    });
  }

  async paint(wanted: Paint): Promise<boolean> {
    return this.save(async () => {
      const { ids, rows } = await this.source.paint(wanted);
      if (!ids.length) throw new ServerError("there is no point to paint here");
      const code = this.codeOf(wanted.class);
      this.strokes.set(ids[ids.length - 1], { ids, rows, code });
      for (const row of rows) this.painted.set(row, code);
      this.done.push(ids);
      this.emit("paint");
      return "Saved";
    });
  }

  async undo(): Promise<boolean> {
    const { leftOut } = this;
    if (leftOut) {
      this.leftOut = null;
      try {
        await this.source.leaveOut(leftOut, true);
      } catch (error) {
        this.report(error, "Not undone");
        return false;
      }
      this.groups = [leftOut, ...this.groups];
      this.emit("queue");
      return true;
    }
    return this.save(async () => {
      const last = this.decisions.at(-1); // after what was being saved
      if (!last) return "Nothing to undo";
      const ids = this.done.find((group) => group.includes(last.id)) ?? [last.id];
      await this.source.undo(ids);
      for (const id of ids) this.strokes.delete(id);
      this.painted.clear();
      for (const stroke of this.strokes.values()) for (const row of stroke.rows) this.painted.set(row, stroke.code);
      this.emit("paint");
      if (this.groups.length) this.groups = await this.source.groups(50); // an answer that was taken back is asked again
      return `Undone: ${last.action.replace("_", " ")}`;
    });
  }

  /** Save once all that is being saved is finished, such as the first part of a long stroke. */
  private async save(act: () => Promise<string>): Promise<boolean> {
    this.waiting++;
    this.leftOut = null;
    const own = this.last.then(() => this.saveNow(act));
    this.last = own.catch(() => false);
    try {
      return await own;
    } finally {
      this.waiting--;
    }
  }

  private async saveNow(act: () => Promise<string>): Promise<boolean> {
    if (this.source.readOnly) {
      this.report(new ServerError("this page is a copy to look at"), "Not saved");
      return false;
    }
    this.say("Saving", "busy");
    const begin = performance.now();
    let done: string;
    try {
      done = await act();
    } catch (error) {
      this.report(error, "Not saved");
      return false;
    }
    const milliseconds = Math.round(performance.now() - begin);
    this.say(`${done} at ${new Date().toLocaleTimeString()} (${milliseconds} ms)`, "ok");
    try {
      await this.refresh();
    } catch (error) {
      this.report(error, "Saved, but the list is old");
    }
    return true;
  }
}

// State of the page: survey, objects after the decisions, filters, selection. Parts of the page listen to its changes.

import { setColours } from "./colours";
import type { Source } from "./source";
import type { Cell, Corrections, Decision, Entry, Note, ObjectState, PointGroup, QueueItem, RoadLine, Status, Survey } from "./types";

export const VIEWS = ["class", "confidence", "intensity", "height", "colour", "object", "status", "error"] as const;
export type View = (typeof VIEWS)[number];
export type Tool = "look" | "measure" | "section" | "paint" | "base" | "merge" | "split" | "add" | "line";
export type List = "objects" | "lines" | "groups" | "decided" | "register" | "changes" | "road";
export type Change = "view" | "filter" | "selection" | "decisions" | "queue" | "tool" | "status" | "saved" | "paint" | "theme" | "marked";
export type Place = [number, number, number];

export interface RoadObject {
  id: number;
  kind: string;
  name: string;
  score: number;
  place: Place;
  height: number;
  cells: Record<string, Cell>;
  /** Whether decisions have changed it: its outline is that of its cells. */
  changed: boolean;
  /** Decision that made it, and the object that it is a part of (0 if it was added); null for listed objects. */
  made: { decision: number; of: number } | null;
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

export interface Message {
  text: string;
  kind: "" | "busy" | "ok" | "bad";
  /** Whether it still holds; messages without it hold until the next one. */
  holds?: () => boolean;
}

export const STATUSES = ["", "accepted", "rejected", "changed", "moved", "merged", "split", "added", "cut", "joined"];
export const KINDS = ["pole", "sign", "tree", "vehicle"];
export const LINE_KINDS = ["kerb", "wire", "lane_line", "stop_line", "crossing", "other_marking", "barrier"];
export const ORDERS = ["first", "number", "kind", "lowest", "highest"] as const;
export type Order = (typeof ORDERS)[number];

/** Kind with the type of a pole, or with the shape of a plate; empty without one. */
export function typeOf({ kind, cells }: RoadObject): string {
  const type = cells.pole_type || cells.panel_shape;
  return type ? `${kind}, ${type}` : "";
}

export class State {
  /** Objects as they are after the decisions, new ones last. */
  objects: RoadObject[] = [];
  byId = new Map<number, RoadObject>();
  kinds: string[] = [];
  readonly classNames = new Map<number, string>();
  classCounts = new Map<number, number>();
  /** Whether the counts are those of all points; before, they are estimates from the sample. */
  counted = false;
  view: View = "class";
  hiddenClasses = new Set<number>();
  hiddenKinds = new Set<string>();
  /** Types of poles and shapes of plates that are hidden. */
  hiddenTypes = new Set<string>();
  hiddenStatuses = new Set<string>();
  leastScore = 0;
  selected: number | null = null;
  point: PickedPoint | null = null;
  tool: Tool = "look";
  brush = { radius: 0.3, class: "", cluster: false, only: true };
  section: { place: Place; heading: number; thickness: number } | null = null;
  states: Record<string, ObjectState> = {};
  decisions: Decision[] = [];
  queue: QueueItem[] = [];
  /** Whether the queue was read; before, an empty one says nothing. */
  queued = false;
  /** What the list at the right holds: objects to look at, groups of points that belong to none, decided objects. */
  list: List = "objects";
  groups: PointGroup[] = [];
  group: PointGroup | null = null;
  /** Chosen line, and the status of decided ones. */
  line: RoadLine | null = null;
  lineStates: Record<string, string> = {};
  /** Lines after the decisions. */
  lines: RoadLine[] = [];
  hiddenLines = new Set<string>();
  /** Chosen entry of a compared table, and whether those without a question are listed. */
  entry: Entry | null = null;
  allEntries = false;
  private checks: Corrections["checked"] = {};
  private readonly tables = new Map<Entry, string>();
  /** Numbers of the objects, or lines where these are listed, that are decided together. */
  marked = new Set<number>();
  order: Order = "first";
  search = "";
  private notes: Corrections["notes"] = {};
  private addedNotes: Corrections["notes"] = {};
  /** Rows of the points of the chosen group. */
  highlighted = new Set<number>();
  painted = new Map<number, number>();
  /** Class code of the points of objects of another class. */
  recoded = new Map<number, number>();
  saved: Message = { text: "", kind: "" };
  tiles: Status = { state: "building", share: 0, mark: "" };
  private readonly listed: RoadObject[];
  private listeners = new Map<Change, (() => void)[]>();

  constructor(
    readonly source: Source,
    readonly survey: Survey,
  ) {
    setColours(survey.colours);
    const { columns, rows } = survey.objects;
    this.listed = rows.map((row) => this.road(Object.fromEntries(columns.map((name, i) => [name, row[i]])), false));
    this.arrange([]);
    this.lines = survey.lines;
    for (const table of Object.keys(survey.entries)) for (const entry of this.entriesOf(table)) this.tables.set(entry, table);
    for (const [code, name] of Object.entries(survey.classes)) this.classNames.set(Number(code), name);
    const share = survey.n_points / Math.max(1, survey.first.n_points);
    for (const [code, n] of Object.entries(survey.first.classes)) this.classCounts.set(Number(code), Math.round(n * share));
  }

  private road(cells: Record<string, Cell>, changed: boolean): RoadObject {
    const place = [0, 1, 2].map((axis) => Number(cells["xyz"[axis]]) - this.survey.origin[axis]) as Place;
    const { decision, of } = cells;
    return {
      id: Number(cells.object_id),
      kind: String(cells.kind),
      name: String(cells.class),
      score: Number(cells.score),
      place,
      height: Number(cells.height ?? 0),
      cells,
      changed,
      made: typeof decision === "number" ? { decision, of: Number(of ?? 0) } : null,
    };
  }

  /** Put changed and new objects into the list. */
  protected arrange(rows: Record<string, Cell>[]): void {
    const changed = new Map(rows.map((cells) => [Number(cells.object_id), this.road(cells, true)]));
    this.objects = this.listed.map((object) => changed.get(object.id) ?? object);
    const known = new Set(this.listed.map((object) => object.id));
    for (const [id, object] of changed) if (!known.has(id)) this.objects.push(object);
    for (const object of this.objects) if (known.has(object.id)) object.made = null; // the first part of a split object
    this.objects = this.objects.filter((object) => !this.state(object.id)?.merged_into);
    this.byId = new Map(this.objects.map((object) => [object.id, object]));
    this.kinds = [...new Set(this.objects.map((object) => object.kind))].sort();
    if (this.selected !== null && !this.byId.has(this.selected)) this.select(null);
  }

  /** Take the answer of the server; true if the colours of points may have changed. */
  protected accept(found: Corrections): boolean {
    this.states = found.states;
    this.decisions = found.decisions;
    this.lineStates = found.lines.status;
    this.notes = found.notes;
    this.addedNotes = found.notes_of_added;
    this.checks = found.checked;
    this.arrange(found.objects);
    this.arrangeLines(found.lines);
    this.marked = new Set([...this.marked].filter((id) => (this.list === "lines" ? this.lineOf(id) : this.byId.has(id))));
    if (found.counts) {
      this.classCounts = new Map(Object.entries(found.counts).map(([code, n]) => [Number(code), n]));
      this.counted = true;
    }
    const before = [...this.recoded].join();
    this.recoded = new Map(Object.entries(found.codes).map(([number, code]) => [Number(number), code]));
    return [...this.recoded].join() !== before;
  }

  private arrangeLines({ rows, gone }: Corrections["lines"]): void {
    const changed = new Map(rows.map((line) => [line.line_id, line]));
    const left = new Set(gone);
    this.lines = this.survey.lines.filter((line) => !left.has(line.line_id)).map((line) => changed.get(line.line_id) ?? line);
    const known = new Set(this.survey.lines.map((line) => line.line_id));
    this.lines.push(...rows.filter((line) => !known.has(line.line_id)));
    if (this.line) this.line = this.lineOf(this.line.line_id) ?? null;
  }

  lineOf(id: number): RoadLine | undefined {
    return this.lines.find((line) => line.line_id === id);
  }

  entriesOf(table: string): Entry[] {
    return this.survey.entries[table] ?? [];
  }

  /** Entries of the compared table that is listed: those with a question, and the others on demand. */
  listedEntries(): Entry[] {
    return this.entriesOf(this.list).filter((entry) => entry.asks || this.allEntries);
  }

  tableOf(entry: Entry): string {
    return this.tables.get(entry)!;
  }

  /** What was decided about the state of an entry: right, wrong or nothing. */
  checked(entry: Entry): string {
    return this.checks[this.tableOf(entry)]?.[entry.name] ?? "";
  }

  /** Place of an entry; without a height it is that of the nearest object. */
  placeOf({ x, y, z }: Entry): Place {
    const { origin } = this.survey;
    const far = ({ place }: RoadObject) => Math.hypot(place[0] + origin[0] - x, place[1] + origin[1] - y);
    const nearest = z === null && this.objects.length ? this.objects.reduce((best, object) => (far(object) < far(best) ? object : best)).place[2] : 0;
    return [x - origin[0], y - origin[1], z === null ? nearest : z - origin[2]];
  }

  lineStatus(line: RoadLine): string {
    return this.lineStates[line.line_id] ?? "";
  }

  /** Note and attributes of an object. */
  noteOf(object: RoadObject): Note | undefined {
    return object.made?.of === 0 ? this.addedNotes[object.made.decision] : this.notes[object.made?.of ?? object.id];
  }

  /** Names of the attributes that any object has. */
  get attributeNames(): string[] {
    return [...new Set([...Object.values(this.notes), ...Object.values(this.addedNotes)].flatMap((note) => Object.keys(note.attributes)))].sort();
  }

  on(changes: Change[], listener: () => void): void {
    for (const change of changes) this.listeners.set(change, [...(this.listeners.get(change) ?? []), listener]);
  }

  emit(change: Change): void {
    for (const listener of this.listeners.get(change) ?? []) listener();
    if (this.saved.holds && !this.saved.holds()) this.set("saved", "saved", { text: "", kind: "" });
  }

  set<K extends keyof this>(change: Change, name: K, value: this[K]): void {
    this[name] = value;
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
    const object = this.byId.get(id);
    return object?.made ? String(object.cells.status) : (this.state(id)?.status ?? "");
  }

  shown(object: RoadObject): boolean {
    return (
      !this.hiddenKinds.has(object.kind) &&
      !this.hiddenTypes.has(typeOf(object)) &&
      !this.hiddenStatuses.has(this.status(object.id)) &&
      (object.score >= this.leastScore || object.made !== null)
    );
  }

  shownLine(line: RoadLine): boolean {
    return !this.hiddenLines.has(line.kind) && !this.hiddenStatuses.has(this.lineStatus(line)) && (line.score ?? 1) >= this.leastScore;
  }

  /** Object of a point with a number: of a split object the part with the nearest base. */
  objectAt(number: number, place: Place): number {
    const parts = this.objects.filter((object) => object.made?.of === number);
    const first = this.byId.get(number);
    if (!parts.length || !first) return this.state(number)?.merged_into ?? number;
    const far = (object: RoadObject) => Math.hypot(object.place[0] - place[0], object.place[1] - place[1]);
    return [first, ...parts].reduce((best, part) => (far(part) < far(best) ? part : best)).id;
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

  selectLine(line: RoadLine): void {
    this.select(null);
    this.line = line;
    this.emit("selection");
  }

  selectEntry(entry: Entry): void {
    this.select(null);
    this.entry = entry;
    this.emit("selection");
  }

  /** Mark objects or lines for a decision about all of them; `add` keeps those that are marked. */
  setMarked(ids: Iterable<number>, add = false): void {
    this.set("marked", "marked", new Set([...(add ? this.marked : []), ...ids]));
  }

  select(id: number | null, point: PickedPoint | null = null): void {
    this.selected = id;
    this.point = point;
    this.line = null;
    this.entry = null;
    this.leaveGroup();
    this.emit("selection");
  }

  protected leaveGroup(): void {
    this.group = null;
    if (!this.highlighted.size) return;
    this.highlighted = new Set();
    this.emit("paint");
  }
}

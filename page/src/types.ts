// Answers of the server.

export type Cell = string | number | null;

export interface FirstFacts {
  n_points: number;
  low: [number, number, number];
  edge: number;
  coloured: boolean;
  has_reference: boolean;
  bounds: [[number, number, number], [number, number, number]];
  intensity: [number, number];
  height: [number, number];
  classes: Record<string, number>;
}

/** A kerb, a wire, a barrier or a marking. */
export interface RoadLine {
  line_id: number;
  kind: string;
  length: number;
  score?: number | null;
  offset?: number | null;
  height?: number | null;
  sag?: number | null;
  clearance?: number | null;
  width?: number | null;
  contrast?: number | null;
  pattern?: string | null;
  from_station?: number | null;
  to_station?: number | null;
  x: number;
  y: number;
  vertices: [number, number, number][];
}

/** Entry of a compared register, or object of two compared surveys. */
export interface Entry {
  name: string;
  kind: string;
  state: string;
  x: number;
  y: number;
  z: number | null;
  object_id: number;
  reason: string;
  asks: boolean;
}

export interface Survey {
  name: string;
  folder: string;
  user: string;
  n_points: number;
  origin: [number, number, number];
  files: [string, number, number][];
  classes: Record<string, string>;
  objects: { columns: string[]; headings: Record<string, string>; rows: Cell[][] };
  footprints: Record<string, [number, number][]>;
  path: [number, number, number][];
  lines: RoadLine[];
  photos: number[];
  colours: { classes: Record<string, string>; kinds: Record<string, string>; lines: Record<string, string> };
  report: boolean;
  /** Name of the file with the background of the map, empty without one. */
  background: string;
  warnings: string[];
  /** Entries of compared tables by name, the states to check in each, and why tables are left out. */
  entries: Record<string, Entry[]>;
  asked: Record<string, string[]>;
  left_out: string[];
  first: FirstFacts;
}

export interface TileFacts {
  edge: number;
  coloured: boolean;
  levels: number;
  coarsest: number;
  undivided: number;
  n_points: number;
  classes: Record<string, number>;
  nodes: [number, number, number, number, number, number][];
}

export interface Status {
  state: "ready" | "building" | "failed" | "stale";
  share: number;
  error?: string;
  /** Changes with every decision, also those of other tabs. */
  mark: string;
}

export interface ObjectState {
  status: string;
  checked_class: string;
  checked_kind: string;
  x?: number;
  y?: number;
  z?: number;
  merged_into?: number;
  decision: number;
  who: string;
  made: string;
}

export interface Decision {
  id: number;
  made: string;
  who: string;
  action: string;
  object_id: number | null;
  what: string;
  /** Number of the line that it is about. */
  line: number | null;
  /** Compared table and entry that it is about. */
  entry: [string | null, string | null];
  /** Whether the object that it is about is listed no more. */
  lost: boolean;
}

/** Texts about an object that users have typed. */
export interface Note {
  text: string;
  attributes: Record<string, string>;
}

export interface Corrections {
  states: Record<string, ObjectState>;
  painted: { id: number; class: string; rows: number[] }[];
  decisions: Decision[];
  /** Rows of objects that decisions have changed or made. */
  objects: Record<string, Cell>[];
  /** Status of decided lines by number, lines that decisions have changed or made, and those that were joined into others. */
  lines: { status: Record<string, string>; rows: RoadLine[]; gone: number[] };
  /** Notes of objects by number, and of added ones by the decision that added them. */
  notes: Record<string, Note>;
  notes_of_added: Record<string, Note>;
  /** Class codes of the points of objects of another class. */
  codes: Record<string, number>;
  /** Points per class code; null while the tiles are not finished. */
  counts: Record<string, number> | null;
  /** What was decided about states of entries, by table and entry. */
  checked: Record<string, Record<string, string>>;
  mark: string;
}

export interface Delivered {
  folder: string;
  files: string[];
  objects: number;
}

export interface QueueItem {
  object_id: number;
  kind: string;
  score: number;
  reason: string;
  expected_precision: number;
}

/** Connected points of one class, to answer about. */
export interface PointGroup {
  place: [number, number, number];
  code: number;
  confidence: number;
}

export interface Wanted {
  action: string;
  object_id?: number;
  kind?: string;
  payload?: Record<string, unknown>;
}

export interface Paint {
  places: [number, number, number][];
  radius: number;
  class: string;
  only?: number;
  cluster?: boolean;
  group?: boolean;
}

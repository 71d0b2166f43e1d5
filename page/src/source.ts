// Where the page takes its data from: the local server, or the page itself if it was exported.

import type { Corrections, Delivered, Paint, PointGroup, QueueItem, Status, Survey, TileFacts, Wanted } from "./types";

export class ServerError extends Error {}

export interface Source {
  readonly readOnly: boolean;
  survey(): Promise<Survey>;
  first(): Promise<ArrayBuffer>;
  status(): Promise<Status>;
  tiles(): Promise<TileFacts>;
  chunk(level: number, begin: number, end: number): Promise<ArrayBuffer>;
  corrections(): Promise<Corrections>;
  states(): Promise<Corrections>;
  queue(number: number): Promise<QueueItem[]>;
  groups(number: number): Promise<PointGroup[]>;
  group(group: PointGroup): Promise<number[]>;
  leaveOut(group: PointGroup, back: boolean): Promise<unknown>;
  decide(wanted: Wanted | { all: Wanted[] }): Promise<{ ids: number[] }>;
  paint(wanted: Paint): Promise<{ ids: number[]; rows: number[]; before: Record<string, number> }>;
  undo(ids: number[]): Promise<void>;
  deliver(formats: string[], checked: boolean): Promise<Delivered>;
  photo(object: number): string;
  /** Address of a picture of the background, and the area that it shows (west, south, east, north). */
  background(area: Area, width: number, height: number): { address: string; area: Area };
}

type Area = [number, number, number, number];

async function answer(address: string, options: RequestInit = {}): Promise<Response> {
  let response: Response;
  try {
    response = await fetch(address, { credentials: "same-origin", ...options });
  } catch {
    throw new ServerError("The server does not answer. Start it again: mlsroad open");
  }
  if (response.ok) return response;
  const text = await response.text();
  let reason = text.trim();
  try {
    reason = JSON.parse(text).error ?? reason;
  } catch {
    // a plain text
  }
  throw new ServerError(reason || `The server answered ${response.status}.`);
}

async function json<T>(address: string): Promise<T> {
  return (await answer(address)).json() as Promise<T>;
}

async function post<T>(address: string, value: unknown): Promise<T> {
  const options = { method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(value) };
  return (await answer(address, options)).json() as Promise<T>;
}

export const server: Source = {
  readOnly: false,
  survey: () => json("/api/survey"),
  first: async () => (await answer("/first.bin")).arrayBuffer(),
  status: () => json("/api/status"),
  tiles: () => json("/tiles/index.json"),
  chunk: async (level, begin, end) =>
    (await answer(`/tiles/level${level}.bin`, { headers: { Range: `bytes=${begin}-${end - 1}` } })).arrayBuffer(),
  corrections: () => json("/api/corrections"),
  states: () => json("/api/states"),
  queue: (number) => json(`/api/queue?number=${number}`),
  groups: (number) => json(`/api/groups?number=${number}`),
  group: async (group) => (await post<{ rows: number[] }>("/api/group", { places: [group.place], only: group.code })).rows,
  leaveOut: (group, back) => post("/api/leave-out", { places: [group.place], back }),
  decide: (wanted) => post("/api/decide", wanted),
  paint: (wanted) => post("/api/paint", wanted),
  undo: (ids) => post("/api/undo", { ids }),
  deliver: (formats, checked) => post("/api/deliver", { formats, checked }),
  photo: (object) => `/files/photos/${object}.jpg`,
  background: (area, width, height) => ({ address: `/background?area=${area.map((value) => value.toFixed(2))}&size=${width},${height}`, area }),
};

interface Embedded {
  survey: Survey;
  corrections: Corrections;
  queue: QueueItem[];
  photos: Record<string, string>;
  background: { address: string; area: Area } | null;
}

async function unpacked(element: Element): Promise<ArrayBuffer> {
  const text = atob((element.textContent ?? "").trim());
  const bytes = Uint8Array.from(text, (letter) => letter.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Response(stream).arrayBuffer();
}

function refuse(): never {
  throw new ServerError("This page is a copy to look at: it saves nothing.");
}

export function embedded(): Source | null {
  const facts = document.getElementById("embedded-survey");
  const points = document.getElementById("embedded-points");
  if (!facts || !points) return null;
  const content = unpacked(facts).then((data) => JSON.parse(new TextDecoder().decode(data)) as Embedded);
  let photos: Record<string, string> = {};
  let background: Embedded["background"] = null;
  content.then((found) => {
    photos = found.photos;
    background = found.background;
  });
  return {
    readOnly: true,
    survey: async () => (await content).survey,
    first: () => unpacked(points),
    status: async () => ({ state: "building", share: 0, mark: "" }),
    tiles: refuse,
    chunk: refuse,
    corrections: async () => (await content).corrections,
    states: async () => (await content).corrections,
    queue: async (number) => (await content).queue.slice(0, number),
    groups: async () => [],
    group: refuse,
    leaveOut: refuse,
    decide: refuse,
    paint: refuse,
    undo: refuse,
    deliver: refuse,
    photo: (object) => photos[object] ?? "",
    background: () => background ?? refuse(),
  };
}

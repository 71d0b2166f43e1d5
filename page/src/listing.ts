// Order of the lists of objects and lines, and what is searched in them.

import { type RoadObject, type State, typeOf } from "./state";
import type { RoadLine } from "./types";

/** Distance from the path beyond which objects and lines come last, metres. */
const FAR = 25;

/** What a list is sorted by. */
interface Listed {
  id: number;
  kind: string;
  score?: number | null;
}

/** Whether a word of a text begins with another: "ground" has no "round". */
function begins(text: string, word: string): boolean {
  return word === "" || text.split(word).slice(0, -1).some((before) => !/\p{L}$/u.test(before));
}

/** Whether a text has all words that are searched; a number is that of the object, or stands in its note. */
function found(state: State, id: number, text: string, note = ""): boolean {
  const all = `${text} ${note}`.toLowerCase();
  return state.search.toLowerCase().split(/\s+/).every((word) => (/^\d+$/.test(word) ? id === Number(word) || note.includes(word) : begins(all, word)));
}

function comparison(state: State): (a: Listed, b: Listed) => number {
  const score = (item: Listed) => item.score ?? 1;
  return {
    first: () => 0,
    number: (a: Listed, b: Listed) => a.id - b.id,
    kind: (a: Listed, b: Listed) => a.kind.localeCompare(b.kind) || a.id - b.id,
    lowest: (a: Listed, b: Listed) => score(a) - score(b) || a.id - b.id,
    highest: (a: Listed, b: Listed) => score(b) - score(a) || a.id - b.id,
  }[state.order];
}

/** Objects in the order of the list: those to look at first, or all that fit what is searched. */
export function listing(state: State): RoadObject[] {
  const rank = new Map(state.queue.map((item, i) => [item.object_id, i]));
  const shown = state.objects.filter((object) => state.shown(object));
  if (state.order === "first" && !state.search.trim()) {
    const queued = shown.filter((object) => !object.made && rank.has(object.id)).sort((a, b) => rank.get(a.id)! - rank.get(b.id)!);
    return [...shown.filter((object) => object.made).reverse(), ...queued];
  }
  const fitting = shown.filter((object) => {
    const note = state.noteOf(object);
    const typed = note ? [note.text, ...Object.entries(note.attributes).flat()].join(" ") : "";
    return found(state, object.id, `${object.kind} ${object.name} ${typeOf(object)} ${state.status(object.id)} ${object.cells.reasons ?? ""}`, typed);
  });
  const byRank = (object: RoadObject) => rank.get(object.id) ?? Infinity;
  return state.order === "first" ? fitting.sort((a, b) => (byRank(a) === byRank(b) ? a.id - b.id : byRank(a) - byRank(b))) : fitting.sort(comparison(state));
}

/** Lines to look at: undecided ones first, uncertain and long ones before others, those far from the path last. */
export function lineOrder(state: State): RoadLine[] {
  const rank = (line: RoadLine) => [
    Number(state.lineStates[line.line_id] !== undefined),
    Number(Math.abs(line.offset ?? 0) > FAR),
    (line.score ?? 1) - Math.log10(1 + line.length) / 10,
  ];
  const text = (line: RoadLine) => `${line.kind.replace("_", " ")} ${state.lineStatus(line)}`;
  const lines = state.lines.filter((line) => state.shownLine(line) && found(state, line.line_id, text(line)));
  const item = ({ line_id: id, kind, score }: RoadLine) => ({ id, kind, score });
  const compare = comparison(state);
  if (state.order !== "first") return lines.sort((a, b) => compare(item(a), item(b)));
  const ranks = new Map(lines.map((line) => [line, rank(line)]));
  return lines.sort((a, b) => {
    const [one, other] = [ranks.get(a)!, ranks.get(b)!];
    const i = one.findIndex((value, k) => value !== other[k]);
    return i < 0 ? a.line_id - b.line_id : one[i] - other[i];
  });
}

// Right side: the chosen object or point, its decisions, and the list of what to look at first.

import { classColour, kindColour, lineColour, STATUS_COLOURS } from "./colours";
import { clear, count, el, swatch } from "./dom";
import type { Actions } from "./actions";
import { objectList } from "./list";
import type { Model, RoadObject } from "./model";
import { NoteForm } from "./notes";
import type { PointGroup, RoadLine } from "./types";

const HIDDEN = new Set(["object_id", "class", "kind", "score", "reasons", "scene", "x_min", "x_max", "y_min", "y_max", "z_min", "z_max",
  "passes", "passes_there", "scanners", "scanners_there", "file_count", "first_time", "last_time", "pole_id", "status", "checked_class"]);

const LINE_MEASURES: [keyof RoadLine, string][] = [
  ["length", "Length [m]"], ["score", "Score"], ["height", "Height [m]"], ["sag", "Sag [m]"], ["clearance", "Clearance [m]"], ["width", "Width [m]"],
  ["contrast", "Contrast"], ["pattern", "Pattern"], ["from_station", "From station [m]"], ["to_station", "To station [m]"], ["offset", "Offset [m]"],
];

/** Replace the children but the one that has the focus, so that typing goes on. */
function replaceAround(parent: HTMLElement, children: (Node | string)[]): void {
  const kept = children.findIndex((child) => child instanceof HTMLElement && child.contains(document.activeElement));
  if (kept < 0) return parent.replaceChildren(...children);
  const own = children[kept] as HTMLElement;
  for (const child of [...parent.childNodes]) if (child !== own) child.remove();
  own.before(...children.slice(0, kept));
  own.after(...children.slice(kept + 1));
}

function number(value: number): string {
  return Number.isInteger(value) ? String(value) : Math.abs(value) >= 1000 ? value.toFixed(2) : String(Number(value.toFixed(3)));
}

function seenBy(object: RoadObject): string {
  const cells = object.cells;
  const parts: string[] = [];
  if (Number(cells.passes) > 0) parts.push(`${cells.passes} of ${cells.passes_there} passes`);
  if (Number(cells.scanners) > 0) parts.push(`${cells.scanners} of ${cells.scanners_there} scanners`);
  return parts.join(", ");
}

export function review(model: Model, actions: Actions): HTMLElement {
  const chosen = el("section", { class: "chosen", id: "chosen", "aria-live": "polite" });
  const notes = new NoteForm(model);
  const history = el("ol", { class: "history", id: "history" });
  const readOnly = model.source.readOnly;

  function objectPart(object: RoadObject): (Node | string)[] {
    const state = model.state(object.id);
    const { kind, made } = object;
    const buttons: [string, string, () => void][] = made ? [["Take back", "", () => void actions.undo(made.decision)]] : [
      ["Accept", "A", () => actions.accept()],
      ["Reject", "R", () => actions.reject()],
      ["Other kind", "K", () => actions.otherKind()],
      ["Merge", "M", () => actions.tool("merge")],
      ["Split", "S", () => actions.tool("split")],
      ["Move base", "B", () => actions.tool("base")],
    ];
    const rows: Node[] = [];
    const { headings, columns } = model.survey.objects;
    for (const name of columns) {
      const value = object.cells[name];
      if (HIDDEN.has(name) || name === "note" || name.startsWith("attr_") || value === null || value === "") continue;
      rows.push(el("tr", {}, el("th", { scope: "row" }, headings[name] ?? name), el("td", {}, typeof value === "number" ? number(value) : value)));
    }
    const seen = seenBy(object);
    if (seen) rows.unshift(el("tr", {}, el("th", { scope: "row" }, "Seen by"), el("td", {}, seen)));
    const pole = Number(object.cells.pole_id ?? 0);
    if (pole) rows.unshift(el("tr", {}, el("th", { scope: "row" }, "On pole"), el("td", {}, el("button", { type: "button", class: "link", click: () => actions.go(pole) }, String(pole)))));
    const reasons = String(object.cells.reasons ?? "").split(";").map((text) => text.trim()).filter(Boolean);
    const status = made
      ? el("p", { class: "state" }, swatch(STATUS_COLOURS[model.status(object.id)], "dot"), made.of ? `part of ${made.of}` : "added")
      : state?.status
      ? el("p", { class: "state" }, swatch(STATUS_COLOURS[state.status], "dot"), `${state.status}${state.checked_class && state.status === "changed" ? ` to ${state.checked_class}` : ""}${state.merged_into ? ` into ${state.merged_into}` : ""} by ${state.who}`)
      : null;
    const meter = el("meter", { min: 0, max: 1, low: 0.5, high: 0.8, optimum: 1, value: object.score, title: "Probability that it is right" });
    return [
      el("h2", { class: "title" }, swatch(kindColour(kind, model.kinds), "dot"), `${kind} ${object.id}`, el("span", { class: "score" }, `score ${object.score.toFixed(2)}`), meter),
      ...(status ? [status] : []),
      ...(readOnly ? [] : [el("div", { class: "buttons" }, ...buttons.map(([text, key, act]) => el("button", { type: "button", "data-action": text, click: act }, text, key && el("kbd", {}, key))))]),
      ...[notes.show(object)].filter((form) => form !== null),
      ...(reasons.length ? [el("ul", { class: "reasons" }, ...reasons.map((reason) => el("li", {}, reason)))] : []),
      ...(model.survey.photos.includes(object.id) ? [el("img", { class: "photo", src: model.source.photo(object.id), alt: `Photo of ${object.kind} ${object.id}`, loading: "lazy" })] : []),
      el("table", { class: "measures" }, el("tbody", {}, ...rows)),
    ];
  }

  function groupPart(group: PointGroup): (Node | string)[] {
    const name = model.className(group.code);
    const buttons: [string, string, () => void][] = [
      ["Right", "A", () => actions.accept()],
      ["Leave out", "R", () => actions.reject()],
      ["Other class", "K", () => actions.otherKind()],
    ];
    return [
      el("h2", { class: "title" }, swatch(classColour(group.code), "dot"), name, el("span", { class: "score" }, `confidence ${group.confidence.toFixed(2)}`)),
      el("div", { class: "buttons" }, ...buttons.map(([text, key, act]) => el("button", { type: "button", "data-action": text, click: act }, text, el("kbd", {}, key)))),
      el("p", { class: "none" }, model.highlighted.size ? `${count(model.highlighted.size)} points are marked. Leave them out if they are of several classes.` : "The points are being marked."),
    ];
  }

  function linePart(line: RoadLine): (Node | string)[] {
    const buttons: [string, string, () => void][] = [
      ["Accept", "A", () => actions.accept()],
      ["Reject", "R", () => actions.reject()],
      ["Other kind", "K", () => actions.otherKind()],
      ["Join", "M", () => actions.tool("merge")],
      ["Cut", "S", () => actions.tool("split")],
      ["Move vertex", "B", () => actions.tool("base")],
    ];
    const status = model.lineStatus(line);
    const measures = LINE_MEASURES.filter(([name]) => typeof line[name] === "number" || (typeof line[name] === "string" && line[name] !== ""));
    return [
      el("h2", { class: "title" }, swatch(lineColour(line.kind), "dot"), `${line.kind.replace("_", " ")} ${line.line_id}`),
      ...(status ? [el("p", { class: "state" }, swatch(STATUS_COLOURS[status], "dot"), status)] : []),
      ...(readOnly ? [] : [el("div", { class: "buttons" }, ...buttons.map(([text, key, act]) => el("button", { type: "button", "data-action": text, click: act }, text, el("kbd", {}, key))))]),
      el("table", { class: "measures" }, el("tbody", {}, ...measures.map(([name, heading]) => el("tr", {}, el("th", { scope: "row" }, heading), el("td", {}, typeof line[name] === "number" ? number(line[name]) : String(line[name])))))),
    ];
  }

  function pointPart(): (Node | string)[] {
    const { point } = model;
    if (!point) return [el("p", { class: "none" }, "Click an object or a point. The key ? lists all keys.")];
    const { origin, files } = model.survey;
    const file = files.find(([, first, n]) => point.row >= first && point.row < first + n);
    const rows: [string, string][] = [
      ["Class", model.className(point.code)],
      ["Confidence", point.confidence.toFixed(2)],
      ["Intensity", String(point.intensity)],
      ...(model.survey.first.has_reference ? ([["Class in the input", model.className(point.reference)]] as [string, string][]) : []),
      ["Easting [m]", (point.place[0] + origin[0]).toFixed(2)],
      ["Northing [m]", (point.place[1] + origin[1]).toFixed(2)],
      ["Elevation [m]", (point.place[2] + origin[2]).toFixed(2)],
      ...(file ? ([["File", file[0]], ["Row", count(point.row - file[1])]] as [string, string][]) : []),
    ];
    return [el("h2", { class: "title" }, "Point"), el("table", { class: "measures" }, el("tbody", {}, ...rows.map(([name, value]) => el("tr", {}, el("th", { scope: "row" }, name), el("td", {}, value)))))];
  }

  function markedPart(): Node[] {
    const { marked } = model;
    if (!marked.size || readOnly) return [];
    const lines = model.list === "lines";
    const kinds = [...marked].map((id) => (lines ? model.lineOf(id)?.kind : model.byId.get(id)?.kind) ?? "");
    const words = [...new Set(kinds)].sort().map((kind) => `${count(kinds.filter((other) => other === kind).length)} × ${kind.replace("_", " ")}`);
    const buttons: [string, string, () => void][] = [
      ["Accept all", "A", () => actions.accept()],
      ["Reject all", "R", () => actions.reject()],
      ["Other kind", "K", () => actions.otherKind()],
      ["Unmark", "Esc", () => model.setMarked([])],
    ];
    return [
      el("h2", { class: "title", id: "marked" }, `${count(marked.size)} ${lines ? "lines" : "objects"} marked`),
      el("p", { class: "state" }, words.join(", ")),
      el("div", { class: "buttons two" }, ...buttons.map(([text, key, act]) => el("button", { type: "button", "data-action": text, click: act }, text, el("kbd", {}, key)))),
    ];
  }

  function showChosen(): void {
    const object = model.selected === null ? undefined : model.byId.get(model.selected);
    const parts = model.entry ? actions.entries.part(model.entry) : model.line ? linePart(model.line) : model.group ? groupPart(model.group) : object ? objectPart(object) : pointPart();
    // Buttons and keys decide about the marked ones while there are any.
    const single = model.marked.size ? parts.filter((part) => !(part instanceof HTMLElement && part.classList.contains("buttons"))) : parts;
    const children = [...markedPart(), ...single];
    if (chosen.contains(document.activeElement)) replaceAround(chosen, children);
    else chosen.replaceChildren(...children);
  }

  function showHistory(): void {
    clear(history);
    for (const decision of [...model.decisions].reverse().slice(0, 100)) {
      const about = decision.object_id ? ` ${decision.object_id}` : "";
      history.append(el("li", {}, el("b", {}, `${decision.action.replace("_", " ")}${about}`), ` ${decision.what} `, decision.lost && el("em", {}, "matches no object "), el("small", {}, `${decision.who}, ${new Date(decision.made).toLocaleString()}`)));
    }
  }

  model.on(["selection", "marked"], () => {
    showChosen();
    if (model.selected !== null || model.group || model.line || model.entry) panel.scrollTop = 0; // to the buttons
  });
  model.on(["queue", "filter"], showChosen);
  model.on(["decisions"], () => {
    showHistory();
    showChosen();
  });
  const list = objectList(model, actions);
  showChosen();
  const panel = el(
    "aside",
    { class: "right", "aria-label": "Review" },
    chosen,
    list,
    el("details", {}, el("summary", {}, "Decisions"), el("button", { type: "button", click: () => void actions.undo() }, "Undo the last", el("kbd", {}, "U")), history),
  );
  return panel;
}

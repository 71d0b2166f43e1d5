// Right side: the chosen object or point, its decisions, and the list of what to look at first.

import { classColour, kindColour, lineColour, STATUS_COLOURS } from "./colours";
import { clear, count, el, swatch } from "./dom";
import type { Actions } from "./actions";
import type { List, Model, RoadObject } from "./model";
import type { PointGroup, RoadLine } from "./types";

const LISTS: [List, string, string][] = [
  ["objects", "Objects", "Objects to look at first"],
  ["lines", "Lines", "Kerbs, wires and markings: uncertain and long ones first"],
  ["decided", "Decided", "Objects that were decided, the last ones first"],
  ["groups", "Places", "Points of no object to look at first: uncertain, many, unlike the places that were answered"],
];

const HIDDEN = new Set(["object_id", "class", "kind", "score", "reasons", "scene", "x_min", "x_max", "y_min", "y_max", "z_min", "z_max",
  "passes", "passes_there", "scanners", "scanners_there", "file_count", "first_time", "last_time", "pole_id", "status", "checked_class"]);

function percent(value: number): string {
  return `${(100 * value).toFixed(1)}\u00a0%`;
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
  const list = el("ol", { class: "queue", id: "queue" });
  const progress = el("p", { class: "progress", id: "progress" });
  const lists = el("div", { class: "lists", role: "radiogroup", "aria-label": "What the list holds" });
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
      if (HIDDEN.has(name) || value === null || value === "") continue;
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
    const buttons: [string, string, () => void][] = [["Accept", "A", () => actions.accept()], ["Reject", "R", () => actions.reject()]];
    const status = model.lineStates[line.line_id];
    const rows: [string, string | number | null | undefined][] = [["Length [m]", line.length], ["Score", line.score], ["Offset [m]", line.offset]];
    return [
      el("h2", { class: "title" }, swatch(lineColour(line.kind), "dot"), `${line.kind.replace("_", " ")} ${line.line_id}`),
      ...(status ? [el("p", { class: "state" }, swatch(STATUS_COLOURS[status], "dot"), status)] : []),
      ...(readOnly ? [] : [el("div", { class: "buttons" }, ...buttons.map(([text, key, act]) => el("button", { type: "button", "data-action": text, click: act }, text, el("kbd", {}, key))))]),
      el("table", { class: "measures" }, el("tbody", {}, ...rows.filter(([, value]) => typeof value === "number").map(([name, value]) => el("tr", {}, el("th", { scope: "row" }, name), el("td", {}, number(value as number)))))),
    ];
  }

  function showLines(): void {
    clear(list);
    const lines = model.lineOrder();
    for (const line of lines.slice(0, 500)) {
      const parts = [swatch(lineColour(line.kind), "dot"), el("span", { class: "name" }, `${line.kind.replace("_", " ")} ${line.line_id}`), el("span", { class: "reason" }, model.lineStates[line.line_id] ?? ""), el("span", { class: "after" }, `${line.length.toFixed(0)} m`)];
      list.append(el("li", { "data-id": line.line_id }, el("button", { type: "button", click: () => actions.goLine(line) }, ...parts)));
    }
    progress.textContent = lines.length ? `${count(Object.keys(model.lineStates).length)} of ${count(lines.length)} lines looked at.` : "The survey has no lines.";
    showChosen();
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

  function showChosen(): void {
    const object = model.selected === null ? undefined : model.byId.get(model.selected);
    chosen.replaceChildren(...(model.line ? linePart(model.line) : model.group ? groupPart(model.group) : object ? objectPart(object) : pointPart()));
    for (const item of list.children) item.classList.toggle("here", (item as HTMLElement).dataset.id === String(model.group?.place ?? model.line?.line_id ?? model.selected));
  }

  function showGroups(): void {
    clear(list);
    for (const group of model.groups) {
      const [name, mark] = [model.className(group.code), swatch(classColour(group.code), "dot")];
      const button = el("button", { type: "button", click: () => actions.goGroup(group) }, mark, el("span", { class: "name" }, name), el("span", { class: "after", title: "Mean confidence" }, percent(group.confidence)));
      list.append(el("li", { "data-id": String(group.place) }, button));
    }
    const answered = model.decisions.filter((decision) => decision.action === "paint").length;
    progress.textContent =
      model.tiles.state !== "ready" ? "The points are still being prepared."
      : model.groups.length ? `${count(answered)} answered or painted. Fifty answers are worth a run of mlsroad learn.`
      : "There is no place to ask about.";
    showChosen();
  }

  function showList(): void {
    for (const button of lists.querySelectorAll("button")) button.setAttribute("aria-checked", String(button.dataset.list === model.list));
    if (model.list === "groups") showGroups();
    else if (model.list === "lines") showLines();
    else if (model.list === "decided") showDecided();
    else showQueue();
  }

  function showQueue(): void {
    clear(list);
    for (const object of model.objects.filter((object) => object.made).reverse()) entry(object.id, object.kind, model.status(object.id));
    for (const item of model.queue) {
      const object = model.byId.get(item.object_id);
      if (!object || !model.shown(object)) continue;
      const after = el("span", { class: "after", title: "Expected precision of the inventory after this look and those above" }, percent(item.expected_precision));
      entry(item.object_id, item.kind, item.reason, after);
    }
    const looked = model.objects.filter((object) => model.status(object.id) !== "").length;
    const kept = model.objects.filter((object) => model.status(object.id) !== "rejected");
    const right = kept.reduce((sum, object) => sum + model.probability(object), 0);
    progress.textContent = model.objects.length
      ? `${count(looked)} of ${count(model.objects.length)} looked at. Expected precision ${percent(kept.length ? right / kept.length : 1)}.`
      : "The survey has no objects.";
    showChosen();
  }

  function entry(id: number, kind: string, reason: string, after?: HTMLElement): void {
    const parts = [swatch(kindColour(kind, model.kinds), "dot"), el("span", { class: "name" }, `${kind} ${id}`), el("span", { class: "reason" }, reason)];
    list.append(el("li", { "data-id": id }, el("button", { type: "button", click: () => actions.go(id) }, ...parts, after)));
  }

  /** List what was decided, the last decisions first. */
  function showDecided(): void {
    clear(list);
    const last = (object: RoadObject) => object.made?.decision ?? model.state(object.id)?.decision ?? 0;
    const decided = model.objects.filter((object) => model.status(object.id) !== "").sort((a, b) => last(b) - last(a) || b.id - a.id);
    for (const object of decided.slice(0, 500)) {
      const state = model.state(object.id);
      const what = state?.status === "changed" ? `changed to ${state.checked_class}` : model.status(object.id);
      entry(object.id, object.kind, what, el("span", { class: "after" }, state?.who ?? ""));
    }
    progress.textContent = decided.length ? `${count(decided.length)} objects were decided.` : "No object was decided.";
    showChosen();
  }

  function showHistory(): void {
    clear(history);
    for (const decision of [...model.decisions].reverse().slice(0, 100)) {
      const about = decision.object_id ? ` ${decision.object_id}` : "";
      history.append(el("li", {}, el("b", {}, `${decision.action.replace("_", " ")}${about}`), ` ${decision.what} `, el("small", {}, `${decision.who}, ${new Date(decision.made).toLocaleString()}`)));
    }
    showList();
  }

  for (const [which, text, title] of LISTS) {
    lists.append(el("button", { type: "button", role: "radio", title, "data-list": which, click: () => actions.showList(which) }, text));
  }
  lists.append(el("kbd", { title: "The other list" }, "J"));
  model.on(["selection"], () => {
    showChosen();
    if (model.selected !== null || model.group || model.line) panel.scrollTop = 0; // to the buttons
  });
  model.on(["queue", "filter"], showList);
  model.on(["decisions"], showHistory);
  showList();
  const panel = el(
    "aside",
    { class: "right", "aria-label": "Review" },
    chosen,
    el("section", { class: "first" }, el("h2", {}, "Look at first", el("kbd", { title: "Next" }, "N")), !readOnly && lists, progress, list),
    el("details", {}, el("summary", {}, "Decisions"), el("button", { type: "button", click: () => void actions.undo() }, "Undo the last", el("kbd", {}, "U")), history),
  );
  return panel;
}

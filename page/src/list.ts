// List of what to look at: objects, lines, places or what was decided; sorted, searched and marked.

import type { Actions } from "./actions";
import { classColour, kindColour, lineColour } from "./colours";
import { clear, count, el, swatch } from "./dom";
import { name } from "./lines";
import { lineOrder, listing } from "./listing";
import { type List, type Model, type Order, ORDERS, type RoadObject } from "./model";
import { inWords } from "./notes";

const LISTS: [List, string, string][] = [
  ["objects", "Objects", "Objects to look at first"],
  ["lines", "Lines", "Kerbs, wires, barriers and markings: uncertain and long ones first"],
  ["decided", "Decided", "Objects that were decided, the last ones first"],
  ["groups", "Places", "Points of no object to look at first: uncertain, many, unlike the places that were answered"],
  ["register", "Register", "Entries of the compared register whose state is to be checked"],
  ["changes", "Changes", "Objects of two compared surveys whose state is to be checked"],
  ["road", "Road", "Places of the road that are low or inside the envelope, and its measures every 10 m"],
];

const ORDER_NAMES: Record<Order, string> = { first: "look at first", number: "number", kind: "kind", lowest: "lowest score", highest: "highest score" };
const MOST = 500; // entries

function percent(value: number): string {
  return `${(100 * value).toFixed(1)}\u00a0%`;
}

export function objectList(model: Model, actions: Actions): HTMLElement {
  const list = el("ol", { class: "queue", id: "queue" });
  const progress = el("p", { class: "progress", id: "progress" });
  const lists = el("div", { class: "lists", role: "radiogroup", "aria-label": "What the list holds" });
  const order = el("select", { id: "order", "aria-label": "Order of the list" }, ...ORDERS.map((value) => el("option", { value }, ORDER_NAMES[value])));
  order.addEventListener("change", () => model.set("queue", "order", order.value as Order));
  const search = el("input", { type: "text", id: "search", placeholder: "Search (/)", "aria-label": "Search by kind, type, shape, number, status, note" });
  search.addEventListener("input", () => model.set("queue", "search", search.value));
  search.addEventListener("keydown", (event) => {
    if (event.key === "Escape") {
      search.value = "";
      model.set("queue", "search", "");
    }
    if (["Enter", "Escape"].includes(event.key)) search.blur();
  });
  const all = el("button", { type: "button", id: "mark-all", title: "Mark all of the list", click: () => model.setMarked(listed()) }, "Mark all");
  const controls = el("div", { class: "controls" }, search, order, !model.source.readOnly && all);
  /** Number of the entry from which Shift marks. */
  let anchor: number | null = null;

  /** Numbers of the objects or lines of the list. */
  function listed(): number[] {
    if (model.list === "lines") return lineOrder(model).map((line) => line.line_id);
    return model.list === "decided" ? decided().map((object) => object.id) : listing(model).map((object) => object.id);
  }

  function mark(id: number, range: boolean): void {
    const ids = listed();
    const [from, to] = [ids.indexOf(anchor ?? id), ids.indexOf(id)].sort((a, b) => a - b);
    const on = !model.marked.has(id);
    anchor = id;
    if (range && from >= 0) model.setMarked(ids.slice(from, to + 1), true);
    else if (on) model.setMarked([id], true);
    else model.setMarked([...model.marked].filter((other) => other !== id));
  }

  function entry(id: number, parts: (Node | string | null | undefined)[], go: () => void, note = ""): void {
    const box = el("input", { type: "checkbox", checked: model.marked.has(id), title: "Mark (Shift marks all between)", "aria-label": `Mark ${id}` });
    box.addEventListener("click", (event) => mark(id, event.shiftKey));
    const button = el("button", { type: "button", click: go }, ...parts, note && el("span", { class: "note" }, note));
    list.append(el("li", { "data-id": id }, !model.source.readOnly && box, button));
  }

  function objectEntry(object: RoadObject, reason: string, after?: HTMLElement): void {
    const parts = [swatch(kindColour(object.kind, model.kinds), "dot"), el("span", { class: "name" }, `${object.kind} ${object.id}`), el("span", { class: "reason" }, reason), after];
    entry(object.id, parts, () => actions.go(object.id), inWords(model.noteOf(object)));
  }

  function showLines(): void {
    const lines = lineOrder(model);
    for (const line of lines.slice(0, MOST)) {
      const after = `${typeof line.score === "number" ? `${line.score.toFixed(2)}, ` : ""}${line.length.toFixed(0)} m`;
      const parts = [swatch(lineColour(line.kind), "dot"), el("span", { class: "name" }, name(line)), el("span", { class: "reason" }, model.lineStatus(line)), el("span", { class: "after" }, after)];
      entry(line.line_id, parts, () => actions.lines.go(line));
    }
    const looked = model.lines.filter((line) => model.lineStatus(line)).length;
    progress.textContent = model.lines.length ? `${count(looked)} of ${count(model.lines.length)} lines looked at.` : "The survey has no lines.";
  }

  function showGroups(): void {
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
  }

  function showQueue(): void {
    const items = new Map(model.queue.map((item) => [item.object_id, item]));
    const objects = listing(model);
    for (const object of objects.slice(0, MOST)) {
      const item = items.get(object.id);
      const precision = item && model.order === "first" && !model.search.trim();
      const after = precision
        ? el("span", { class: "after", title: "Expected precision of the inventory after this look and those above" }, percent(item.expected_precision))
        : el("span", { class: "after", title: "Score" }, Number.isFinite(object.score) ? object.score.toFixed(2) : "");
      objectEntry(object, model.status(object.id) || (item?.reason ?? ""), object.made ? undefined : after);
    }
    const looked = model.objects.filter((object) => model.status(object.id) !== "").length;
    const kept = model.objects.filter((object) => model.status(object.id) !== "rejected");
    const right = kept.reduce((sum, object) => sum + model.probability(object), 0);
    const found = model.search.trim() ? `${count(objects.length)} found. ` : "";
    progress.textContent = model.objects.length
      ? `${found}${count(looked)} of ${count(model.objects.length)} looked at. Expected precision ${percent(kept.length ? right / kept.length : 1)}.`
      : "The survey has no objects.";
  }

  /** Objects that were decided, the last decisions first. */
  function decided(): RoadObject[] {
    const last = (object: RoadObject) => object.made?.decision ?? model.state(object.id)?.decision ?? 0;
    return model.objects.filter((object) => model.status(object.id) !== "").sort((a, b) => last(b) - last(a) || b.id - a.id);
  }

  function showDecided(): void {
    const objects = decided();
    for (const object of objects.slice(0, MOST)) {
      const state = model.state(object.id);
      const what = state?.status === "changed" ? `changed to ${state.checked_class}` : model.status(object.id);
      objectEntry(object, what, el("span", { class: "after" }, state?.who ?? ""));
    }
    progress.textContent = objects.length ? `${count(objects.length)} objects were decided.` : "No object was decided.";
  }

  function showHere(): void {
    const here = String(model.group?.place ?? model.entry?.name ?? model.line?.line_id ?? model.selected);
    for (const item of list.children) {
      const id = (item as HTMLElement).dataset.id;
      item.classList.toggle("here", id === here);
      const box = item.querySelector("input");
      if (box) box.checked = model.marked.has(Number(id));
    }
  }

  function show(): void {
    for (const button of lists.querySelectorAll("button")) button.setAttribute("aria-checked", String(button.dataset.list === model.list));
    const compared = model.survey.entries[model.list] !== undefined;
    controls.hidden = model.list === "groups" || model.list === "decided" || compared;
    clear(list);
    if (compared) actions.entries.show(list, progress, MOST);
    else if (model.list === "groups") showGroups();
    else if (model.list === "lines") showLines();
    else if (model.list === "decided") showDecided();
    else showQueue();
    showHere();
  }

  for (const [which, text, title] of LISTS) {
    if (["register", "changes", "road"].includes(which) && !model.survey.entries[which]) continue;
    lists.append(el("button", { type: "button", role: "radio", title, "data-list": which, click: () => actions.showList(which) }, text));
  }
  lists.append(el("kbd", { title: "The other list" }, "J"));
  model.on(["queue", "filter", "decisions"], show);
  model.on(["selection", "marked"], showHere);
  show();
  return el("section", { class: "first" }, el("h2", {}, "Look at first", el("kbd", { title: "Next" }, "N")), (!model.source.readOnly || Object.keys(model.survey.entries).length > 0) && lists, controls, progress, list);
}

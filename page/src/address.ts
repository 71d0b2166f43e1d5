// Object, line, entry or place in the address: gone to when the page opens or the address changes, written when one is chosen.

import type { Actions } from "./actions";
import type { List, Model, Place } from "./model";

/** Part of the address that names what is chosen; empty if nothing is. */
function chosen(model: Model): string {
  const { origin } = model.survey;
  if (model.selected !== null) return `#object=${model.selected}`;
  if (model.entry) return `#${model.tableOf(model.entry)}=${encodeURIComponent(model.entry.name)}`;
  if (model.line) return `#line=${model.line.line_id}`;
  if (model.group) return `#place=${model.group.place.map((value, axis) => (value + origin[axis]).toFixed(2))}`;
  return "";
}

/** Go to what an address names; say so where the survey has none. */
function go(address: string, model: Model, actions: Actions): void {
  const [what, value] = address.slice(1).split("=");
  const numbers = (value ?? "").split(",").map(Number);
  const isPlace = what === "place" && [2, 3].includes(numbers.length) && numbers.every(Number.isFinite);
  const line = what === "line" ? model.lineOf(numbers[0]) : undefined;
  const entry = model.entriesOf(what).find(({ name }) => encodeURIComponent(name) === value);
  if (what === "object" && model.byId.has(numbers[0])) actions.go(numbers[0]);
  else if (line) {
    actions.showList("lines");
    actions.lines.go(line);
  } else if (entry) {
    actions.showList(what as List);
    actions.entries.go(entry);
  } else if (isPlace) {
    const { origin } = model.survey;
    const height = numbers[2] ?? actions.cloud.target[2] + origin[2];
    const place = [numbers[0], numbers[1], height].map((number, axis) => number - origin[axis]) as Place;
    model.select(null);
    history.replaceState(null, "", address);
    actions.cloud.focusGroup(place);
  } else if (address.length > 1) {
    actions.hint(`The survey has no ${what} ${value ?? ""}: it was labelled again, or the address is wrong.`, () => location.hash === address);
  }
}

export function followAddress(model: Model, actions: Actions): void {
  const first = location.hash;
  model.on(["selection"], () => {
    const now = chosen(model);
    if (now !== location.hash) history.replaceState(null, "", now || location.pathname);
  });
  addEventListener("hashchange", () => go(location.hash, model, actions));
  if (first) go(first, model, actions);
}

// Entries of a compared register, objects of two compared surveys, places of a road: their states are right or wrong.

import type { Cloud } from "./cloud";
import { kindColour } from "./colours";
import { count, el, swatch } from "./dom";
import type { Model, Tool } from "./model";
import type { Entry } from "./types";

/** What entries need of the actions. */
interface Host {
  readonly model: Model;
  readonly cloud: Cloud;
  go(id: number): void;
  accept(): void;
  reject(): void;
  tool(tool: Tool): void;
}

export class Entries {
  constructor(private readonly actions: Host) {}

  private get model() {
    return this.actions.model;
  }

  /** Entries of the list: states that need a check first, by importance, checked ones after them; others on demand. */
  order(): Entry[] {
    const { model } = this;
    const { asked } = model.survey;
    const rank = (entry: Entry) => Number(!entry.asks) * 100 + Number(model.checked(entry) !== "") * 50 + asked[model.list].indexOf(entry.state);
    return model.listedEntries().sort((a, b) => rank(a) - rank(b));
  }

  go(entry: Entry): void {
    this.actions.tool("look");
    this.model.selectEntry(entry);
    this.actions.cloud.focusGroup(this.model.placeOf(entry));
  }

  next(step: number): void {
    const entries = this.order();
    if (!entries.length) return;
    const here = entries.indexOf(this.model.entry!);
    this.go(entries[here < 0 ? 0 : (here + step + entries.length) % entries.length]);
  }

  /** Say whether the state of an entry is right, and go on to the next one of the list. */
  async decide(entry: Entry, checked: "right" | "wrong"): Promise<void> {
    const { model } = this;
    if (model.busy) return;
    const entries = this.order();
    const following = entries[entries.indexOf(entry) + 1];
    const { name, kind, state, x, y } = entry;
    const done = await model.decide({ action: "check", kind, payload: { table: model.tableOf(entry), entry: name, state, x, y, checked } });
    if (done && following && model.entry === entry) this.go(following);
  }

  /** The chosen entry with what decides about it. */
  part(entry: Entry): Node[] {
    const { model, actions } = this;
    const checked = model.checked(entry);
    const object = model.byId.get(entry.object_id);
    const buttons: [string, string, () => void][] = [["State is right", "A", () => actions.accept()], ["State is wrong", "R", () => actions.reject()]];
    return [
      el("h2", { class: "title" }, swatch(kindColour(entry.kind, model.kinds), "dot"), `${entry.kind} ${entry.name}`, el("span", { class: "score" }, entry.state)),
      el("p", { class: "state" }, [checked && `state is ${checked}`, entry.reason].filter(Boolean).join("; ")),
      ...(model.source.readOnly ? [] : [el("div", { class: "buttons two" }, ...buttons.map(([text, key, act]) => el("button", { type: "button", "data-action": text, click: act }, text, el("kbd", {}, key))))]),
      ...(object ? [el("button", { type: "button", class: "link", click: () => actions.go(object.id) }, `${object.kind} ${object.id}`)] : []),
    ];
  }

  /** Fill the list and its line of progress. */
  show(list: HTMLElement, progress: HTMLElement, most: number): void {
    const { model } = this;
    for (const entry of this.order().slice(0, most)) {
      const parts = [swatch(kindColour(entry.kind, model.kinds), "dot"), el("span", { class: "name" }, `${entry.kind} ${entry.name}`), el("span", { class: "reason" }, `${entry.state}: ${entry.reason}`)];
      const after = el("span", { class: "after" }, model.checked(entry));
      list.append(el("li", { "data-id": entry.name }, el("button", { type: "button", click: () => this.go(entry) }, ...parts, after)));
    }
    const all = model.entriesOf(model.list);
    const asked = all.filter((entry) => entry.asks);
    const left = asked.filter((entry) => model.checked(entry) === "").length;
    const rest = all.filter((entry) => !entry.asks).map(({ state }) => state);
    const words = [...new Set(rest)].map((state) => `${count(rest.filter((other) => other === state).length)} ${state}`).join(", ");
    const toggle = el("button", { type: "button", class: "link", id: "rest", click: () => model.set("queue", "allEntries", !model.allEntries) }, model.allEntries ? "Hide these" : "Show these");
    progress.replaceChildren(`${count(left)} of ${count(asked.length)} states left to check. ${words ? `${words}. ` : ""}`, ...(words ? [toggle] : []));
  }
}

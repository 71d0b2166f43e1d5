// Note and attributes of an object, as they are typed in its panel.

import { el } from "./dom";
import type { Model, RoadObject } from "./model";
import type { Note } from "./types";

export class NoteForm {
  private element: HTMLElement | null = null;
  private of = 0;

  constructor(private readonly model: Model) {}

  /** Form of an object; the one in which somebody types stays. */
  show(object: RoadObject): HTMLElement | null {
    if (object.made && object.made.of > 0) return null; // the first part has the texts of all
    const typing = this.of === object.id && this.element?.contains(document.activeElement);
    if (this.element && typing) return this.element;
    this.of = object.id;
    this.element = this.build(object);
    return this.element;
  }

  private build(object: RoadObject): HTMLElement {
    const { model } = this;
    const known = model.noteOf(object) ?? { text: "", attributes: {} };
    const readOnly = model.source.readOnly;
    const field = (label: string, value: string, more = {}) => el("input", { type: "text", "aria-label": label, placeholder: label, value, readOnly, ...more });
    const text = field("Note", known.text, { id: "note", maxlength: 1000 });
    const rows = Object.entries(known.attributes).map(([name, value]) => ({ name: () => name, shown: el("span", {}, name) as HTMLElement, value: field(name, value, { maxlength: 200, "data-attribute": name }) }));
    const name = field("attribute", "", { id: "attribute", list: "attributes", maxlength: 40 });
    if (!readOnly) rows.push({ name: () => plain(name.value), shown: name, value: field("value", "", { id: "value", maxlength: 200 }) });
    const save = () => {
      const attributes = rows.map((row) => [row.name(), row.value.value.trim()]).filter(([key, value]) => key && value);
      void this.save(object, { text: text.value.trim(), attributes: Object.fromEntries(attributes) }, known);
    };
    text.addEventListener("change", save);
    for (const row of rows) row.value.addEventListener("change", save);
    name.addEventListener("change", () => name.value && rows.at(-1)!.value.value && save());
    const form = el(
      "section",
      { class: "notes", "aria-label": "Note and attributes" },
      text,
      ...rows.map((row) => el("div", { class: "pair" }, row.shown, row.value)),
      el("datalist", { id: "attributes" }, ...["material", "number", "condition", ...model.attributeNames].filter((other, i, all) => all.indexOf(other) === i).map((other) => el("option", { value: other }))),
    );
    form.addEventListener("keydown", (event) => {
      if (event.key === "Enter" || event.key === "Escape") (event.target as HTMLElement).blur(); // leaves the field, which saves it
    });
    return form;
  }

  private async save(object: RoadObject, typed: Note, known: Note): Promise<void> {
    if (JSON.stringify([typed.text, Object.entries(typed.attributes).sort()]) === JSON.stringify([known.text, Object.entries(known.attributes).sort()])) return;
    const about = object.made ? { added: object.made.decision } : {};
    const payload = { note: typed.text, attributes: typed.attributes, ...about };
    const done = await this.model.decide({ action: "note", ...(object.made ? {} : { object_id: object.id }), payload });
    if (done) Object.assign(known, typed);
  }
}

/** Name of an attribute as it is stored: small letters, digits and _. */
export function plain(name: string): string {
  return name.trim().toLowerCase().replace(/[^\p{L}\p{N}]+/gu, "_").replace(/^_+|_+$/g, "");
}

/** Note and attributes in a line. */
export function inWords(note: Note | undefined): string {
  return note ? [note.text, ...Object.entries(note.attributes).map(([name, value]) => `${name}: ${value}`)].filter(Boolean).join("; ") : "";
}

// Dialog that asks for a kind or a class.

import { el } from "./dom";
import type { Model } from "./model";

/** Ask for a kind by number keys, or for a class. */
export function ask(model: Model, question: string, kinds: string[], answer: (kind: string, name: string) => void, classes = model.group === null): void {
  const dialog = el("dialog", { class: "ask", "aria-label": question });
  const finish = (kind: string, name: string) => {
    dialog.close();
    answer(kind, name);
  };
  const names = [...model.classNames.values()];
  const select = el("select", { "aria-label": "Class" }, el("option", { value: "" }, "another class"), ...names.map((name) => el("option", { value: name }, name)));
  select.addEventListener("change", () => select.value && finish("", select.value));
  dialog.append(
    el("h2", {}, question),
    el("div", { class: "buttons" }, ...kinds.map((kind, i) => el("button", { type: "button", click: () => finish(kind, "") }, kind.replaceAll("_", " "), i < 9 && el("kbd", {}, String(i + 1))))),
    ...(classes ? [el("p", {}, "It is no object of these kinds, but of ", select)] : []),
    el("button", { type: "button", click: () => dialog.close() }, "Cancel", el("kbd", {}, "Esc")),
  );
  dialog.addEventListener("keydown", (event) => {
    event.stopPropagation();
    const kind = kinds[Number(event.key) - 1];
    if (kind) finish(kind, "");
  });
  dialog.addEventListener("close", () => dialog.remove());
  document.body.append(dialog);
  dialog.showModal();
}

// Keys, and the overlay that lists them.

import type { Actions } from "./actions";
import type { Cloud } from "./cloud";
import { el } from "./dom";
import { viewsOf } from "./filters";
import type { Model } from "./model";

type Key = [keys: string[], text: string, act: (key: string) => void];

export function keys(model: Model, cloud: Cloud, actions: Actions, theme: () => void, largerMap: () => void): { help: () => void } {
  const views = viewsOf(model);
  const groups: [string, Key[]][] = [
    ["Review", [
      [["n"], "next object or place to look at", () => actions.next()],
      [["N"], "the one before", () => actions.next(-1)],
      [["a"], "accept: the object or line, all marked ones, the class of the place, or the state of the entry", () => actions.accept()],
      [["r"], "reject the object or line, or all marked ones; leave the place out; the state is wrong", () => actions.reject()],
      [["k"], "other kind or class", () => actions.otherKind()],
      [["m"], "merge with another object; join with another line", () => actions.tool("merge")],
      [["s"], "split: click bases, then Enter; cut a line", () => actions.tool("split")],
      [["b"], "move the base, or a vertex of the line", () => actions.tool("base")],
      [["i"], "add a missing object", () => actions.tool("add")],
      [["w"], "draw a missing line: click its vertices, then Enter", () => actions.tool("line")],
      [["/"], "search in the list", () => document.querySelector<HTMLInputElement>("#search")?.focus()],
      [["j"], "list of objects or of uncertain places", () => actions.toggleList()],
      [["u", "z"], "undo the last decision", () => void actions.undo()],
    ]],
    ["Tools", [
      [["v", "Escape"], "look: end a tool, unmark what is marked", () => actions.escape()],
      [["d"], "measure a distance", () => actions.tool("measure")],
      [["x"], "section across the road, on and off", () => actions.section()],
      [[",", "."], "move the section along the road", (key) => actions.moveSection(key === "." ? 1 : -1)],
      [["[", "]"], "thinner, thicker section", (key) => actions.moveSection(0, key === "]" ? 1.5 : 1 / 1.5)],
      [["p"], "paint points", () => actions.tool("paint")],
      [["Enter"], "end a split, or a line that is drawn", () => actions.finish()],
    ]],
    ["View", [
      [views.map((_, i) => String(i + 1)), `colour by ${views.join(", ")}`, (key) => model.set("view", "view", views[Number(key) - 1])],
      [["ArrowLeft", "ArrowRight", "ArrowUp", "ArrowDown"], "move", (key) => cloud.step(key === "ArrowLeft" ? -0.1 : key === "ArrowRight" ? 0.1 : 0, key === "ArrowUp" ? 0.1 : key === "ArrowDown" ? -0.1 : 0)],
      [["q", "e"], "turn", (key) => cloud.turn(key === "q" ? 0.15 : -0.15)],
      [["+", "=", "-"], "zoom", (key) => cloud.zoom(key === "-" ? 1.25 : 0.8)],
      [["f"], "go to the chosen object", () => model.selected !== null && cloud.focus(model.selected)],
      [["c"], "show or hide what is in front of the object", () => {
        cloud.cutaway = !cloud.cutaway;
        cloud.draw();
      }],
      [["h", "Home"], "show all", () => cloud.showAll()],
      [["t"], "from above", () => cloud.fromAbove()],
      [["o"], "marks of objects on and off", () => {
        cloud.marks.visible = !cloud.marks.visible;
        cloud.marks.update();
        cloud.draw();
      }],
      [["g"], "larger map", largerMap],
      [["l"], "light or dark", theme],
      [["?"], "this list", () => help()],
    ]],
  ];
  const acts = new Map<string, Key>();
  for (const [, list] of groups) for (const key of list) for (const name of key[0]) acts.set(name, key);

  const NAMES: Record<string, string> = { ArrowLeft: "←", ArrowRight: "→", ArrowUp: "↑", ArrowDown: "↓", Escape: "Esc", N: "Shift N" };

  function help(): void {
    document.querySelector("dialog.help")?.remove();
    const dialog = el("dialog", { class: "help", "aria-label": "Keys" });
    dialog.append(
      el("h2", {}, "Keys"),
      el(
        "div",
        { class: "groups" },
        ...groups.map(([title, list]) =>
          el("section", {}, el("h3", {}, title), el("dl", {}, ...list.flatMap(([names, text]) => [
            el("dt", {}, ...(names.length > 4 ? [el("kbd", {}, names[0]), "–", el("kbd", {}, names.at(-1)!)] : names.filter((name) => name !== "=").map((name) => el("kbd", {}, NAMES[name] ?? name.toUpperCase())))),
            el("dd", {}, text),
          ]))),
        ),
      ),
      el("p", {}, "Mouse: left drag turns, right drag moves, the wheel zooms to the pointer, a double click goes to a point."),
      el("button", { type: "button", click: () => dialog.close() }, "Close", el("kbd", {}, "Esc")),
    );
    dialog.addEventListener("close", () => dialog.remove());
    document.body.append(dialog);
    dialog.showModal();
  }

  window.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const at = event.target as HTMLElement;
    if (document.querySelector("dialog[open]") || at.closest("select, textarea, input[type=text]")) return;
    if (at.matches("input[type=range]") && event.key.startsWith("Arrow")) return;
    if (at.matches("button, summary, input") && ["Enter", " "].includes(event.key)) return;
    const name = event.key.length === 1 && event.key !== "N" ? event.key.toLowerCase() : event.key;
    const key = acts.get(name);
    if (!key) return;
    event.preventDefault();
    key[2](name);
  });
  return { help };
}

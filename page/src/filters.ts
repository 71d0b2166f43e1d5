// Left side: what colours the points, classes, kinds, score and status.

import { classColour, kindColour, lineColour, STATUS_COLOURS } from "./colours";
import { clear, count, el, short, swatch } from "./dom";
import { LINE_KINDS, type Model, STATUSES, typeOf, type View, VIEWS } from "./model";

const NAMES: Record<View, string> = {
  class: "Class",
  confidence: "Confidence",
  intensity: "Intensity",
  height: "Height",
  colour: "Colour",
  object: "Object",
  status: "Status",
  error: "Difference",
};

export function viewsOf(model: Model): View[] {
  const { first } = model.survey;
  return VIEWS.filter((view) => (view !== "colour" || first.coloured) && (view !== "error" || first.has_reference));
}

export function filters(model: Model, setSplat: (value: number) => void): HTMLElement {
  const views = el("div", { class: "views", role: "radiogroup", "aria-label": "Colour of the points" });
  viewsOf(model).forEach((view, i) => {
    views.append(
      el("button", { type: "button", role: "radio", "data-view": view, title: `Key ${i + 1}`, click: () => model.set("view", "view", view) }, NAMES[view]),
    );
  });
  const scale = el("div", { class: "scale" });
  const estimated = el("small", { id: "estimated", title: "The points are still being prepared" }, " estimates from a sample");
  const classes = el("ul", { class: "rows", id: "classes" });
  const kinds = el("ul", { class: "rows", id: "kinds" });
  const lineKinds = el("ul", { class: "rows", id: "lines" });
  const [lineTitle, statusTitle] = [el("h2", {}, "Lines"), el("h2", {}, "Status")];
  const statuses = el("ul", { class: "rows", id: "statuses" });
  const slider = el("input", { type: "range", min: 0, max: 1, step: 0.01, value: 0, id: "score", "aria-label": "Least score of the objects" });
  slider.addEventListener("input", () => model.set("filter", "leastScore", Number(slider.value)));
  const least = el("output", { id: "least" });
  const expected = el("p", { class: "expected", id: "expected", role: "status" });
  const size = el("input", { type: "range", min: 0.01, max: 0.2, step: 0.01, value: 0.05, "aria-label": "Size of the points" });
  size.addEventListener("input", () => setSplat(Number(size.value)));

  const row = (label: string, mark: HTMLElement, n: string, hidden: boolean, toggle: () => void, only: () => void) =>
    el(
      "li",
      {},
      el("label", {}, el("input", { type: "checkbox", checked: !hidden, change: toggle }), mark, el("span", { class: "name" }, label), el("b", {}, n)),
      el("button", { type: "button", class: "only", title: `Show ${label} alone`, click: only }, "only"),
    );

  function toggled<T>(set: Set<T>, value: T): Set<T> {
    const next = new Set(set);
    if (!next.delete(value)) next.add(value);
    return next;
  }

  function othersThan<T>(all: T[], value: T, hidden: Set<T>): Set<T> {
    const alone = all.filter((item) => !hidden.has(item));
    return alone.length === 1 && alone[0] === value ? new Set() : new Set(all.filter((item) => item !== value));
  }

  function update(): void {
    for (const button of views.querySelectorAll("button")) {
      button.setAttribute("aria-checked", String(button.dataset.view === model.view));
    }
    clear(scale);
    if (["confidence", "height", "intensity"].includes(model.view)) {
      const { first, origin } = model.survey;
      const [low, high] =
        model.view === "confidence" ? ["0", "1"]
        : model.view === "height" ? first.height.map((z) => `${(z + origin[2]).toFixed(1)} m`)
        : first.intensity.map((value) => value.toFixed(0));
      scale.append(el("span", {}, low), el("i", { class: model.view === "intensity" ? "gray ramp" : "ramp" }), el("span", {}, high));
    } else if (model.view === "error") {
      scale.append(swatch("#f23326"), "other class than in the input ", swatch("#4d6b8c"), "same ", swatch("#595959"), "none in the input");
    }
    estimated.hidden = model.counted;
    clear(classes);
    const all = [...model.classCounts].sort((a, b) => b[1] - a[1]);
    for (const [code, n] of all) {
      classes.append(
        row(
          model.className(code), swatch(classColour(code)), short(n), model.hiddenClasses.has(code),
          () => model.set("filter", "hiddenClasses", toggled(model.hiddenClasses, code)),
          () => model.set("filter", "hiddenClasses", othersThan(all.map(([other]) => other), code, model.hiddenClasses)),
        ),
      );
    }
    clear(kinds);
    for (const kind of model.kinds) {
      const { n, right } = model.expected(kind);
      const total = model.objects.filter((object) => object.kind === kind).length;
      kinds.append(
        row(
          kind, swatch(kindColour(kind, model.kinds), kind === "sign" || kind === "vehicle" ? "square" : "dot"),
          n === total ? count(n) : `${count(n)} of ${count(total)}`, model.hiddenKinds.has(kind),
          () => model.set("filter", "hiddenKinds", toggled(model.hiddenKinds, kind)),
          () => model.set("filter", "hiddenKinds", othersThan(model.kinds, kind, model.hiddenKinds)),
        ),
      );
      (kinds.lastElementChild as HTMLElement).title = `${n} shown, about ${right.toFixed(1)} of them right`;
    }
    const types = [...new Set(model.objects.map(typeOf))].filter((type) => type).sort();
    for (const type of types) {
      const own = model.objects.filter((object) => typeOf(object) === type);
      kinds.append(
        row(
          type, swatch(kindColour(own[0].kind, model.kinds), own[0].kind === "sign" ? "square" : "dot"), count(own.length), model.hiddenTypes.has(type),
          () => model.set("filter", "hiddenTypes", toggled(model.hiddenTypes, type)),
          () => model.set("filter", "hiddenTypes", othersThan(["", ...types], type, model.hiddenTypes)),
        ),
      );
    }
    clear(lineKinds);
    lineTitle.hidden = !model.lines.length;
    for (const kind of LINE_KINDS) {
      const own = model.lines.filter((line) => line.kind === kind);
      if (!own.length) continue;
      lineKinds.append(
        row(
          kind.replace("_", " "), swatch(lineColour(kind), "dot"), count(own.length), model.hiddenLines.has(kind),
          () => model.set("filter", "hiddenLines", toggled(model.hiddenLines, kind)),
          () => model.set("filter", "hiddenLines", othersThan(LINE_KINDS, kind, model.hiddenLines)),
        ),
      );
    }
    clear(statuses);
    const ofLines = model.list === "lines";
    statusTitle.textContent = ofLines ? "Status of the lines" : "Status";
    for (const status of STATUSES) {
      const n = ofLines
        ? model.lines.filter((line) => model.lineStatus(line) === status).length
        : model.objects.filter((object) => model.status(object.id) === status).length;
      if (!n && status !== "" && !model.hiddenStatuses.has(status)) continue;
      statuses.append(
        row(
          status || "not looked at", swatch(STATUS_COLOURS[status]), count(n), model.hiddenStatuses.has(status),
          () => model.set("filter", "hiddenStatuses", toggled(model.hiddenStatuses, status)),
          () => model.set("filter", "hiddenStatuses", othersThan(STATUSES, status, model.hiddenStatuses)),
        ),
      );
    }
    least.value = model.leastScore.toFixed(2);
    const { n, right } = model.expected();
    const share = n ? `, about ${right.toFixed(right < 10 ? 1 : 0)} right (${Math.round((100 * right) / n)} %)` : "";
    expected.textContent = `${count(n)} of ${count(model.objects.length)} objects${share}`;
  }
  model.on(["view", "filter", "decisions", "status"], update);
  update();
  return el(
    "aside",
    { class: "left", "aria-label": "Colours and filters" },
    el("h2", {}, "Colour points by"),
    views,
    scale,
    el("label", { class: "inline" }, "Size", size),
    el("h2", {}, "Classes", estimated),
    classes,
    el("h2", {}, "Objects"),
    kinds,
    el("label", { class: "inline" }, "Score from", slider, least),
    expected,
    lineTitle,
    lineKinds,
    statusTitle,
    statuses,
  );
}

// Pointer on the cloud: clicks, strokes of the brush, and the overlay of the tools.

import * as THREE from "three";

import type { Actions } from "./actions";
import type { Cloud } from "./cloud";
import { el } from "./dom";
import type { Model, Place, Tool } from "./model";

const TOOLS: [Tool, string, string, string][] = [
  ["look", "Look", "V", "Click an object or a point. Drag turns, right drag moves, the wheel zooms."],
  ["measure", "Measure", "D", "Click two points: distance in space, level and in height."],
  ["section", "Section", "X", "Section across the road. Keys , and . move it, [ and ] make it thinner or thicker."],
  ["paint", "Paint", "P", "Drag over points to give them the class. Right drag turns the view."],
  ["add", "Add object", "I", "Click the base of an object that is missing."],
  ["line", "Draw line", "W", "Click the vertices of a line that is missing, then press Enter."],
];
const MOST_PLACES = 150; // of a request; the server takes 200
const LINE_HINTS: Partial<Record<Tool, string>> = {
  base: "Click a vertex of the line (a cross), then its right place.",
  merge: "Click the line that belongs to the chosen one.",
  split: "Click the place at which the line is cut.",
};
const HINTS: Partial<Record<Tool, string>> = {
  base: "Click the right base of the chosen object.",
  merge: "Click the object that belongs to the chosen one.",
  split: "Click the base of each part, then press Enter.",
};

export function tools(model: Model, cloud: Cloud, actions: Actions): HTMLElement {
  const bar = el("div", { class: "tools", role: "toolbar", "aria-label": "Tools" });
  for (const [tool, name, key, text] of TOOLS) {
    if (model.source.readOnly && ["paint", "add", "line"].includes(tool)) continue;
    const act = () => (tool === "section" ? actions.section() : actions.tool(tool));
    bar.append(el("button", { type: "button", title: text, "data-tool": tool, click: act }, name, el("kbd", {}, key)));
  }
  const hint = el("p", { class: "hint", role: "status" });
  const label = el("div", { class: "distance", hidden: true });
  const brush = brushOptions(model);
  cloud.host.append(label);
  let stroke: Place[] | null = null;
  let down: { x: number; y: number; button: number } | null = null;

  function showTool(): void {
    for (const button of bar.querySelectorAll("button")) {
      const tool = button.dataset.tool;
      button.setAttribute("aria-pressed", String(tool === "section" ? model.section !== null : tool === model.tool));
    }
    const section = model.section && model.tool === "look" ? `Section of ${model.section.thickness.toFixed(1)} m. , and . move it, [ and ] change its thickness, X ends it.` : "";
    const ofLine = model.tool === "base" && actions.lines.vertex !== null ? "Click the right place of the vertex." : LINE_HINTS[model.tool];
    hint.textContent = (model.line ? ofLine : undefined) ?? HINTS[model.tool] ?? (model.tool === "look" ? section : (TOOLS.find(([tool]) => tool === model.tool)?.[3] ?? ""));
    brush.hidden = model.tool !== "paint";
    cloud.canvas.dataset.tool = model.tool;
    const painting = model.tool === "paint";
    cloud.controls.mouseButtons = painting
      ? { MIDDLE: THREE.MOUSE.PAN, RIGHT: THREE.MOUSE.ROTATE }
      : { LEFT: THREE.MOUSE.ROTATE, MIDDLE: THREE.MOUSE.DOLLY, RIGHT: THREE.MOUSE.PAN };
    if (!painting) cloud.marks.brush.visible = false;
    showPlaces();
  }

  function showPlaces(): void {
    const { places } = actions;
    const lines: Place[] = actions.lines.drawn();
    if (model.tool === "measure" && places.length === 2) {
      const [a, b] = places;
      const corner: Place = [b[0], b[1], a[2]];
      lines.push(a, b, a, corner, corner, b);
    } else if (model.tool !== "line") for (const [x, y, z] of places) lines.push([x - 0.3, y, z], [x + 0.3, y, z], [x, y - 0.3, z], [x, y + 0.3, z], [x, y, z], [x, y, z + 1.5]);
    cloud.marks.setLines(lines);
    placeLabel();
    cloud.draw();
  }

  function placeLabel(): void {
    const [a, b] = actions.places;
    label.hidden = model.tool !== "measure" || !a || !b;
    if (label.hidden) return;
    const middle = cloud.project([(a[0] + b[0]) / 2, (a[1] + b[1]) / 2, (a[2] + b[2]) / 2]);
    const [x, y, z] = [b[0] - a[0], b[1] - a[1], b[2] - a[2]];
    label.textContent = `${Math.hypot(x, y, z).toFixed(3)} m (level ${Math.hypot(x, y).toFixed(3)} m, height ${z.toFixed(3)} m)`;
    if (middle) {
      label.style.left = `${middle.x}px`;
      label.style.top = `${middle.y}px`;
    } else label.hidden = true;
  }

  function click(event: PointerEvent): void {
    const { clientX: x, clientY: y } = event;
    const mark = cloud.pickMark(x, y);
    const point = cloud.pick(x, y);
    if (actions.lines.click(x, y, point?.place ?? null)) return showPlaces();
    switch (model.tool) {
      case "look":
      case "section": {
        const id = mark ?? (point ? model.objectAt(point.object, point.place) : 0);
        if (id && model.byId.has(id)) model.select(id, point);
        else model.select(null, point);
        break;
      }
      case "merge": {
        const id = mark ?? point?.object ?? 0;
        if (id && model.byId.has(id)) actions.merge(id);
        else actions.missed("There is no object here: click on one.");
        break;
      }
      case "measure":
        if (point) actions.places = actions.places.length === 1 ? [...actions.places, point.place] : [point.place];
        break;
      case "split":
        if (point) actions.places = [...actions.places, point.place];
        break;
      case "base":
        if (point) actions.moveBase(point.place);
        break;
      case "add":
        if (point) actions.add(point.place);
        break;
    }
    if (!point && ["measure", "split", "base", "add"].includes(model.tool)) actions.missed("There is no point here: click on a point.");
    showPlaces();
  }

  function paintAt(x: number, y: number): void {
    const point = cloud.pick(x, y);
    if (!point || !stroke) return;
    const last = stroke.at(-1);
    const far = !last || Math.hypot(...point.place.map((value, i) => value - last[i])) > model.brush.radius / 2;
    if (!far) return;
    strokeClass ??= point.code;
    stroke.push(point.place);
    if (stroke.length < MOST_PLACES || model.brush.cluster) return;
    send(stroke); // a long stroke is saved in parts
    stroke = [point.place];
  }
  let strokeClass: number | null = null;

  function send(places: Place[]): void {
    if (!places.length || strokeClass === null) return;
    const { radius, cluster, only } = model.brush;
    const own = only || cluster ? { only: strokeClass } : {};
    void model.paint({ places: cluster ? places.slice(0, 1) : places, radius, class: model.brush.class, cluster, ...own });
  }

  function endStroke(): void {
    const places = stroke;
    stroke = null;
    if (places) send(places);
  }

  cloud.canvas.addEventListener("pointerdown", (event) => {
    down = { x: event.clientX, y: event.clientY, button: event.button };
    cloud.canvas.focus({ preventScroll: true });
    if (model.tool === "paint" && event.button === 0) {
      stroke = [];
      strokeClass = null;
      cloud.canvas.setPointerCapture(event.pointerId);
      paintAt(event.clientX, event.clientY);
    }
  });
  let hover = 0;
  cloud.canvas.addEventListener("pointermove", (event) => {
    if (model.tool !== "paint") return;
    if (stroke) paintAt(event.clientX, event.clientY);
    if (performance.now() - hover < 60) return;
    hover = performance.now();
    const point = cloud.pick(event.clientX, event.clientY);
    cloud.marks.brush.visible = point !== null && !model.brush.cluster;
    if (point) {
      cloud.marks.brush.position.set(...point.place);
      cloud.marks.brush.scale.setScalar(model.brush.radius);
    }
    cloud.draw();
  });
  cloud.canvas.addEventListener("pointerup", (event) => {
    const begin = down;
    down = null;
    if (stroke) {
      endStroke();
      return;
    }
    if (begin && begin.button === 0 && Math.hypot(event.clientX - begin.x, event.clientY - begin.y) < 4) click(event);
  });
  cloud.canvas.addEventListener("pointercancel", () => {
    down = null;
    endStroke(); // what was painted until then is saved
  });
  cloud.canvas.addEventListener("dblclick", (event) => {
    const point = cloud.pick(event.clientX, event.clientY);
    if (point && model.tool === "look") cloud.look(point.place, Math.min(cloud.distance, 25));
  });
  actions.onPlaces = showPlaces;
  cloud.controls.addEventListener("change", placeLabel);
  model.on(["tool"], showTool);
  showTool();
  return el("div", { class: "overlay" }, bar, brush, hint);
}

function brushOptions(model: Model): HTMLElement {
  const names = [...model.classCounts.keys()].map((code) => model.className(code));
  const all = [...new Set([...names, ...model.classNames.values()])];
  model.brush.class = all[0] ?? "";
  const select = el("select", { id: "brush-class", "aria-label": "Class to paint" }, ...all.map((name) => el("option", { value: name }, name)));
  select.addEventListener("change", () => (model.brush.class = select.value));
  const radius = el("input", { type: "range", min: 0.05, max: 2, step: 0.05, value: model.brush.radius, "aria-label": "Radius of the brush" });
  const size = el("output", {}, `${model.brush.radius.toFixed(2)} m`);
  radius.addEventListener("input", () => {
    model.brush.radius = Number(radius.value);
    size.value = `${model.brush.radius.toFixed(2)} m`;
  });
  const only = el("input", { type: "checkbox", checked: model.brush.only });
  only.addEventListener("change", () => (model.brush.only = only.checked));
  const cluster = el("input", { type: "checkbox", id: "brush-cluster", checked: false });
  cluster.addEventListener("change", () => (model.brush.cluster = cluster.checked));
  return el(
    "div",
    { class: "brush", hidden: true },
    el("label", {}, "Class ", select),
    el("label", {}, "Radius ", radius, size),
    el("label", {}, only, "only points of the class under the pointer"),
    el("label", {}, cluster, "whole cluster: all connected points of that class"),
  );
}

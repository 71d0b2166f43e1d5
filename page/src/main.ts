// Page of a labelled survey: builds the parts and connects them.

import "./style.css";

import { Actions } from "./actions";
import { followAddress } from "./address";
import { Cloud } from "./cloud";
import { deliver } from "./deliver";
import { count, el, short } from "./dom";
import { SectionGrid } from "./grid";
import { filters } from "./filters";
import { keys } from "./keys";
import { SurveyMap } from "./map";
import { Model } from "./model";
import { review } from "./review";
import { embedded, server } from "./source";
import { coarsePoints } from "./tiles";
import { tools } from "./tools";
import type { Survey } from "./types";

const THEMES = ["dark", "light"] as const;

function setTheme(theme: string): void {
  document.documentElement.dataset.theme = theme;
  try {
    localStorage.setItem("mlsroad-theme", theme);
  } catch {
    // an exported page may have no storage
  }
}

function firstTheme(): string {
  let kept: string | null = null;
  try {
    kept = localStorage.getItem("mlsroad-theme");
  } catch {
    // as above
  }
  return kept ?? (matchMedia("(prefers-color-scheme: light)").matches ? "light" : "dark");
}

async function start(): Promise<void> {
  const app = document.getElementById("app")!;
  setTheme(firstTheme());
  if (location.search) history.replaceState(null, "", `/${location.hash}`); // the token of the address is used up
  const waiting = el("p", { class: "waiting" }, "Reading the survey");
  app.append(waiting);
  const source = embedded() ?? server;
  const points = source.first();
  points.catch(() => {});
  const survey = await source.survey();
  const model = new Model(source, survey);
  document.title = `${survey.name} – mlsroad`;
  const host = el("main", { class: "cloud" });
  const left = el("div", { class: "column" });
  const right = el("div", { class: "column" });
  const status = el("footer", { class: "status" });
  const saved = el("span", { class: "saved", id: "saved", role: "status" });
  const shown = el("span", { id: "shown" });
  const progress = el("span", { id: "tiles" });
  const undo = el("button", { type: "button", title: "Take the last decision back (U)", click: () => void actions.undo() }, "Undo", el("kbd", {}, "U"));
  undo.hidden = true;
  status.append(saved, undo, progress, shown);
  const toggleTheme = () => {
    setTheme(THEMES[(THEMES.indexOf(document.documentElement.dataset.theme as "dark") + 1) % 2]);
    model.emit("theme");
  };
  const total = el("span", { id: "total" });
  const header = el(
    "header",
    {},
    el("strong", {}, "mlsroad"),
    el("h1", {}, survey.name),
    total,
    source.readOnly && el("span", { class: "tag" }, "a copy to look at"),
    el("span", { class: "space" }),
    !source.readOnly && el("button", { type: "button", id: "deliver", title: "Write the corrected inventory and points", click: () => deliver(model) }, "Deliver"),
    survey.report && !source.readOnly && el("a", { href: "/report", target: "_blank", rel: "noopener" }, "Report"),
    el("button", { type: "button", title: "Light or dark (L)", click: toggleTheme }, "Light / dark"),
    el("button", { type: "button", id: "help", title: "All keys (?)", click: () => keyboard.help() }, "Keys", el("kbd", {}, "?")),
  );
  waiting.remove();
  app.append(header, left, host, right, status);
  const cloud = new Cloud(host, model);
  const actions = new Actions(model, cloud);
  const map = new SurveyMap(model, cloud, (id) => actions.go(id), (line) => {
    actions.showList("lines");
    actions.lines.go(line);
  }, (entry) => actions.entries.go(entry));
  const grid = new SectionGrid(model, cloud);
  host.append(tools(model, cloud, actions));
  left.append(filters(model, (value) => {
    cloud.splat = value;
  }));
  right.append(map.element, review(model, actions));
  const keyboard = keys(model, cloud, actions, toggleTheme, () => map.toggleSize());
  (window as any).page = { model, cloud, actions, map, grid }; // for tests and the console

  cloud.onFrame = () => {
    shown.textContent = `${short(cloud.shown)} of ${short(survey.n_points)} points drawn${model.tiles.state === "ready" ? "" : " (a sample)"}${cloud.hiding ? ", those in front of the object are hidden (C)" : ""}${cloud.loading ? ", loading" : ""}`;
    if (cloud.failed) progress.textContent = cloud.failed;
    map.draw();
    grid.draw();
  };
  const showTotal = () => {
    total.textContent = `${count(survey.n_points)} points, ${count(model.objects.length)} objects`;
    undo.hidden = !model.undoable.length || source.readOnly;
  };
  model.on(["decisions"], showTotal);
  showTotal();
  model.on(["saved"], () => {
    saved.textContent = model.saved.text;
    saved.dataset.kind = model.saved.kind;
  });
  const data = await points;
  cloud.setFirst(data);
  await cloud.drawn();
  performance.mark("first-picture");
  map.setPoints(...sampled(data, survey));
  await model.load();
  followAddress(model, actions);
  if (survey.left_out.length) actions.hint(survey.left_out.join("; "), () => true);
  if (!source.readOnly) await watch(model, cloud, map, progress);
}

/** Places and classes of the sample. */
function sampled(data: ArrayBuffer, survey: Survey): [Float32Array, Uint8Array] {
  const { n_points: n, low, edge } = survey.first;
  const steps = new Uint16Array(data, 0, 4 * n);
  const codes = new Uint8Array(data, 16 * n, 4 * n);
  const places = new Float32Array(3 * n);
  const classes = new Uint8Array(n);
  for (let i = 0; i < n; i++) {
    for (let axis = 0; axis < 3; axis++) places[3 * i + axis] = low[axis] + (steps[4 * i + axis] * edge) / 65536;
    classes[i] = codes[4 * i];
  }
  return [places, classes];
}

/** Follow the building of the tiles, and take them once they are ready. */
async function watch(model: Model, cloud: Cloud, map: SurveyMap, progress: HTMLElement): Promise<void> {
  for (;;) {
    let wait = 500;
    try {
      const status = await model.source.status();
      const changed = status.state !== model.tiles.state;
      model.tiles = status;
      if (changed) model.emit("status");
      if (status.state === "ready" && changed) {
        const facts = await model.source.tiles();
        cloud.setTiles(facts);
        await model.load(); // with the counts of all points
        model.emit("status");
        const coarse = await coarsePoints(model.source, facts);
        map.setPoints(coarse.places, coarse.codes);
        (window as any).page.complete = true;
      }
      progress.textContent =
        status.state === "building" ? `Preparing the points: ${Math.round(100 * status.share)} %, a sample is shown`
        : status.state === "failed" ? `The points cannot be prepared, a sample is shown: ${status.error}`
        : status.state === "stale" ? "The survey was labelled again: end the page and open it again"
        : "";
      await model.follow(status);
      if (status.state !== "building") wait = 1000;
    } catch (error) {
      progress.textContent = error instanceof Error ? error.message : String(error);
      wait = 3000;
    }
    await new Promise((resolve) => setTimeout(resolve, wait));
  }
}

start().catch((error) => {
  document.getElementById("app")!.replaceChildren(el("p", { class: "waiting bad" }, `The page cannot be shown: ${error instanceof Error ? error.message : error}`));
});

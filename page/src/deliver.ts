// Dialog that writes the corrected inventory and points into a new folder of the output.

import { count, el } from "./dom";
import type { Model } from "./model";

const FORMATS: [string, string, boolean][] = [
  [".gpkg", "GeoPackage", true],
  [".parquet", "GeoParquet", false],
  [".csv", "CSV", false],
  [".geojson", "GeoJSON", false],
  [".fgb", "FlatGeobuf", false],
  [".shp", "Shapefile", false],
  [".gml", "GML", false],
  [".dxf", "DXF", false],
  [".xodr", "OpenDRIVE", false],
  [".laz", "points (LAZ)", false],
  [".vpc", "virtual point cloud", false],
  [".stac.json", "STAC item", false],
  [".html", "protocol of the check", true],
];

export function deliver(model: Model): void {
  const boxes = FORMATS.map(([suffix, , checked]) => el("input", { type: "checkbox", "data-format": suffix, checked }));
  const only = el("input", { type: "checkbox", id: "only-checked", checked: false });
  const result = el("p", { id: "delivered", role: "status" });
  const order = el("button", { type: "button", id: "write", click: () => void write() }, "Write");
  const dialog = el(
    "dialog",
    { class: "ask", "aria-label": "Deliver" },
    el("h2", {}, "Deliver the corrected inventory"),
    el("div", { class: "formats" }, ...FORMATS.map(([, name], i) => el("label", {}, boxes[i], name))),
    el("label", {}, only, "leave out what nobody looked at"),
    result,
    el("div", { class: "buttons" }, order, el("button", { type: "button", click: () => dialog.close() }, "Close", el("kbd", {}, "Esc"))),
  );

  async function write(): Promise<void> {
    const formats = boxes.filter((box) => box.checked).map((box) => box.dataset.format!);
    order.disabled = true;
    result.textContent = "The files are being written.";
    try {
      const { folder, files, objects } = await model.source.deliver(formats, only.checked);
      result.textContent = `${count(objects)} objects in ${folder}: ${files.join(", ")}`;
    } catch (error) {
      result.textContent = `Not written: ${error instanceof Error ? error.message : String(error)}`;
    }
    order.disabled = false;
  }

  dialog.addEventListener("keydown", (event) => event.stopPropagation());
  dialog.addEventListener("close", () => dialog.remove());
  document.body.append(dialog);
  dialog.showModal();
}

// Orthophoto or map tiles under the map: a picture of the part that is seen, which the server takes from a local file.

import { el } from "./dom";
import type { Source } from "./source";

type Area = [west: number, south: number, east: number, north: number];

const MARGIN = 0.3; // of the seen part, on each side
const WAIT = 120; // for further movement, milliseconds

export class Background {
  private sheet: { picture: HTMLImageElement; area: Area } | null = null;
  private wanted = "";
  private timer = 0;
  shown = true;
  /** Why there is no picture. */
  failed = "";

  constructor(
    private readonly source: Source,
    private readonly changed: () => void,
  ) {}

  /** Picture and its area in world coordinates, the best that is there; another one is ordered where it does not fit. */
  at(seen: Area, pixelsPerMetre: number): { picture: HTMLImageElement; area: Area } | null {
    const fits = this.sheet && covers(this.sheet.area, seen);
    const own = this.sheet ? this.sheet.picture.naturalWidth / (this.sheet.area[2] - this.sheet.area[0]) : 0;
    if (!fits || own < pixelsPerMetre * 0.7 || own > pixelsPerMetre * 3) this.order(seen, pixelsPerMetre);
    return this.sheet;
  }

  private order(seen: Area, pixelsPerMetre: number): void {
    const [width, height] = [seen[2] - seen[0], seen[3] - seen[1]];
    const area: Area = [seen[0] - MARGIN * width, seen[1] - MARGIN * height, seen[2] + MARGIN * width, seen[3] + MARGIN * height];
    const size = [width, height].map((metres) => Math.max(1, Math.min(2048, Math.round(metres * (1 + 2 * MARGIN) * pixelsPerMetre))));
    const { address, area: given } = this.source.background(area, size[0], size[1]);
    if (address === this.wanted) return;
    this.wanted = address;
    clearTimeout(this.timer);
    this.timer = window.setTimeout(() => {
      const picture = el("img", {});
      picture.addEventListener("load", () => {
        if (this.wanted !== address) return;
        this.sheet = { picture, area: given };
        this.failed = "";
        this.changed();
      });
      picture.addEventListener("error", () => {
        if (this.wanted !== address) return;
        this.failed = "The background cannot be read.";
        this.changed();
      });
      picture.src = address;
    }, WAIT);
  }
}

function covers(area: Area, seen: Area): boolean {
  return area[0] <= seen[0] && area[1] <= seen[1] && area[2] >= seen[2] && area[3] >= seen[3];
}

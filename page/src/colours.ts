// Colours of classes, kinds, lines and decisions. Those of the survey come with it: they are those of its report.

import type { Survey } from "./types";

const OTHERS = ["#57b8ff", "#c7a000", "#00a38b", "#b97cff", "#ff7a45", "#5e8c31", "#c2185b", "#607d8b"];


let table: Survey["colours"] = { classes: {}, kinds: {}, lines: {} };

export function setColours(colours: Survey["colours"]): void {
  table = colours;
}

export function classColour(code: number): string {
  return table.classes[code] ?? OTHERS[code % OTHERS.length];
}

export function kindColour(kind: string, kinds: string[]): string {
  return table.kinds[kind] ?? OTHERS[Math.max(0, kinds.indexOf(kind)) % OTHERS.length];
}

export function lineColour(kind: string): string {
  return table.lines[kind] ?? "#ffffff";
}

export function channels(colour: string): [number, number, number] {
  const value = parseInt(colour.slice(1), 16);
  return [value >> 16, (value >> 8) & 255, value & 255];
}

export const STATUS_COLOURS: Record<string, string> = {
  "": "#8d96a5",
  accepted: "#2e9e46",
  rejected: "#d83a34",
  changed: "#c98a00",
  moved: "#2f6fed",
  merged: "#8e5bd6",
  split: "#8e5bd6",
  added: "#00a38b",
  cut: "#8e5bd6",
  joined: "#8e5bd6",
};

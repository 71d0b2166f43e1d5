// Colours of classes, kinds and decisions.

const CLASSES: Record<number, string> = {
  1: "#8d8d8d",
  2: "#a5824f",
  3: "#9ccc4a",
  4: "#7cb342",
  5: "#2e9e46",
  6: "#d98e5f",
  7: "#d0d0d0",
  11: "#8a8fa3",
  14: "#35c6d8",
  64: "#2f6fed",
  65: "#f0442e",
  66: "#d948b8",
  67: "#f2c230",
  68: "#b06a3c",
  69: "#8e5bd6",
  70: "#ff8fa3",
};
const OTHERS = ["#57b8ff", "#c7a000", "#00a38b", "#b97cff", "#ff7a45", "#5e8c31", "#c2185b", "#607d8b"];

export function classColour(code: number): string {
  return CLASSES[code] ?? OTHERS[code % OTHERS.length];
}

const KINDS: Record<string, string> = { pole: "#3f7bf0", sign: "#f0603a", tree: "#26a65b", vehicle: "#d948b8" };

export function kindColour(kind: string, kinds: string[]): string {
  return KINDS[kind] ?? OTHERS[Math.max(0, kinds.indexOf(kind)) % OTHERS.length];
}

export const LINE_COLOURS: Record<string, string> = {
  kerb: "#e0a030",
  wire: "#35c6d8",
  lane_line: "#008caa",
  stop_line: "#c81e3c",
  crossing: "#e68200",
  other_marking: "#6e7d87",
};

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
};

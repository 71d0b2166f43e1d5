// Elements from text; text is never read as HTML.

type Child = Node | string | null | undefined | false;

export function el<K extends keyof HTMLElementTagNameMap>(
  tag: K,
  attributes: Record<string, string | number | boolean | ((event: any) => void)> = {},
  ...children: Child[]
): HTMLElementTagNameMap[K] {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (typeof value === "function") element.addEventListener(name, value);
    else if (typeof value === "boolean") {
      if (name in element) (element as any)[name] = value;
      else element.toggleAttribute(name, value);
    } else if (name === "value") (element as any).value = String(value);
    else element.setAttribute(name, String(value));
  }
  element.append(...children.filter((child): child is Node | string => child !== null && child !== undefined && child !== false));
  return element;
}

export function swatch(colour: string, shape = "square"): HTMLElement {
  const mark = el("i", { class: `swatch ${shape}` });
  mark.style.background = colour;
  return mark;
}

export function count(value: number): string {
  return value.toLocaleString("en");
}

export function short(value: number): string {
  if (value >= 1e6) return `${(value / 1e6).toFixed(value >= 1e7 ? 0 : 1)} M`;
  return value >= 1e4 ? `${Math.round(value / 1e3)} k` : count(value);
}

export function clear(element: Element): void {
  element.replaceChildren();
}

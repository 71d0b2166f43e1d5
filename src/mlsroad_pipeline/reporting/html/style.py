"""Style sheet of reports."""

STYLE = """
:root { --ink: #22262e; --soft: #5c6470; --line: #dde1e7; --paper: #ffffff; --back: #f4f6f8; --accent: #1f4e96;
  --warn: #fff6e0; --warn-line: #e0a100; --swatch: #9aa0aa; }
* { box-sizing: border-box; }
html { scroll-behavior: smooth; }
body { margin: 0; background: var(--back); color: var(--ink);
  font: 15px/1.5 system-ui, "Segoe UI", Roboto, "Noto Sans", "DejaVu Sans", sans-serif; }
header { background: var(--accent); color: #fff; padding: 1.4rem 2rem 1.2rem; }
header h1 { margin: 0; font-size: 1.5rem; font-weight: 650; }
header p { margin: .2rem 0 0; opacity: .85; overflow-wrap: anywhere; }
nav { position: sticky; top: 0; z-index: 1; display: flex; flex-wrap: wrap; gap: .2rem 1.2rem; padding: .55rem 2rem;
  background: var(--paper); border-bottom: 1px solid var(--line); }
nav a { color: var(--accent); text-decoration: none; font-size: .9rem; }
nav a:hover { text-decoration: underline; }
main { max-width: 1180px; margin: 0 auto; padding: 1rem; }
section { background: var(--paper); border: 1px solid var(--line); border-radius: 6px; padding: 1rem 1.4rem 1.2rem;
  margin: 1rem 0; scroll-margin-top: 3rem; }
h2 { font-size: 1.12rem; margin: 0 0 .7rem; }
h3 { font-size: .95rem; margin: 1.2rem 0 .4rem; }
p { margin: .3rem 0 .7rem; max-width: 75ch; }
.none { color: var(--soft); }
dl { display: grid; grid-template-columns: max-content 1fr; gap: .25rem 1.5rem; margin: 0; }
dt { color: var(--soft); }
dd { margin: 0; overflow-wrap: anywhere; }
.scroll { overflow-x: auto; margin-bottom: .8rem; }
table { border-collapse: collapse; font-size: .88rem; font-variant-numeric: tabular-nums; }
th, td { padding: .28rem .8rem .28rem 0; text-align: left; border-bottom: 1px solid var(--line); white-space: nowrap; }
thead th { color: var(--soft); font-weight: 600; border-bottom: 2px solid var(--line); }
tbody th { font-weight: 400; }
tbody tr:hover { background: var(--back); }
.number { text-align: right; }
i { display: inline-block; width: .8em; height: .8em; margin-right: .5em; border: 1px solid var(--swatch);
  border-radius: 2px; }
.bar { width: 24rem; }
.bar b { display: block; height: .75em; min-width: 1px; border-radius: 2px; }
figure { margin: 0 0 1.4rem; }
figure img { max-width: 100%; height: auto; display: block; background: #fff; }
figcaption { color: var(--soft); font-size: .88rem; margin-top: .3rem; }
.gallery { display: flex; flex-wrap: wrap; gap: .8rem 1rem; }
.gallery figure { margin: 0; max-width: 30.5rem; }
.warnings { margin: 0; padding: .6rem 1rem .6rem 2rem; background: var(--warn);
  border-left: 4px solid var(--warn-line); }
a { color: var(--accent); }
.legend { border: 0; padding: 0; margin: 0 0 .5rem; display: flex; flex-wrap: wrap; gap: .3rem 1.1rem; }
.legend legend { position: absolute; width: 1px; height: 1px; overflow: hidden; clip-path: inset(50%); }
.legend label { cursor: pointer; display: inline-flex; align-items: center; gap: .35rem; }
.legend i { margin: 0; border: 0; }
.legend i.dot { border-radius: 50%; }
.legend i.line { height: 3px; background: #22262e; border-radius: 0; width: 1.2em; }
.legend i.kerb { background: #96571a; }
.legend i.wire { background: #6e2896; }
.legend i.lane_line { background: #008caa; }
.legend i.stop_line { background: #c81e3c; }
.legend i.crossing { background: #e68200; }
.legend i.other_marking { background: #6e7d87; }
.map { position: relative; border: 1px solid var(--line); border-radius: 4px; overflow: hidden; background: #fff; }
#map { display: block; width: 100%; touch-action: pan-y; cursor: grab; }
#map:focus-visible, button:focus-visible, input:focus-visible, select:focus-visible { outline: 3px solid #e0a100;
  outline-offset: -3px; }
#map .path { fill: none; stroke: #22262e; stroke-width: 2px; stroke-dasharray: 6 3; vector-effect: non-scaling-stroke; }
#map .kerbs, #map .wires, #map .lane_lines, #map .stop_lines, #map .crossings, #map .other_markings {
  fill: none; stroke: #96571a; stroke-width: 2px; vector-effect: non-scaling-stroke; }
#map .wires { stroke: #6e2896; stroke-width: 1px; }
#map .lane_lines { stroke: #008caa; stroke-width: 1.5px; }
#map .stop_lines { stroke: #c81e3c; }
#map .crossings { stroke: #e68200; }
#map .other_markings { stroke: #6e7d87; stroke-width: 1px; }
#map .o path { stroke-width: 9px; stroke-linecap: round; vector-effect: non-scaling-stroke; }
#map .o.square path { stroke-linecap: square; stroke-width: 7px; }
#map .o path.chosen { stroke-width: 18px; stroke: #e0a100; }
.map-buttons { position: absolute; top: .5rem; left: .5rem; display: flex; gap: .25rem; }
button { font: inherit; color: var(--accent); background: #fff; border: 1px solid #8a93a3; border-radius: 4px;
  padding: .1rem .55rem; cursor: pointer; }
.north { position: absolute; top: .5rem; right: .5rem; width: 44px; height: 44px; background: rgba(255, 255, 255, .8); }
.north path { fill: var(--ink); }
.north text { font-size: 9px; font-weight: 700; }
.scale { position: absolute; left: .6rem; bottom: .6rem; border: 2px solid var(--ink); border-top: 0; padding: 0 .3rem;
  font-size: .8rem; text-align: center; background: rgba(255, 255, 255, .8); white-space: nowrap; }
.details { min-height: 5.5rem; padding-top: .6rem; }
.details h3 { margin: 0 0 .3rem; }
.details dl { grid-template-columns: repeat(4, max-content minmax(3rem, 1fr)); gap: .1rem .8rem; font-size: .85rem; }
.filters { display: flex; flex-wrap: wrap; gap: .4rem 1.2rem; align-items: center; margin: .6rem 0; }
.filters input, .filters select { font: inherit; padding: .1rem .3rem; }
.filters input[type=number] { width: 4.6rem; }
.objects { max-height: 36rem; overflow: auto; border: 1px solid var(--line); }
.objects table { border-collapse: separate; border-spacing: 0; }
.objects th, .objects td { padding-left: .5rem; }
.objects thead th { position: sticky; top: 0; z-index: 2; background: var(--back); }
.objects thead button { border: 0; background: none; color: var(--ink); padding: 0; font-weight: 600;
  white-space: nowrap; }
.objects th[aria-sort=ascending] button::after { content: " \u2191"; }
.objects th[aria-sort=descending] button::after { content: " \u2193"; }
.objects td:first-child, .objects th:first-child { position: sticky; left: 0; background: var(--paper); z-index: 1; }
.objects th:first-child { z-index: 3; background: var(--back); }
.paper { display: none; }
.keys { display: flex; flex-wrap: wrap; gap: .2rem 1rem; padding: 0; margin: .2rem 0 1rem; list-style: none;
  font-size: .88rem; }
@media print { @page { margin: 12mm; } nav, .map-buttons, .filters, .details, #object-more { display: none; }
  body { background: #fff; font-size: 11px; print-color-adjust: exact; -webkit-print-color-adjust: exact; }
  header { padding: .6rem 0; color: #000; background: #fff; } main { max-width: none; padding: 0; }
  section { border: 0; padding: 0; margin: .6rem 0; } h2, h3 { break-after: avoid; }
  figure, tr, .map { break-inside: avoid; } thead { display: table-header-group; }
  .scroll, .objects { overflow: visible; max-height: none; border: 0; }
  .scroll table { font-size: 7px; width: 100%; }
  .scroll th, .scroll td { padding: 1px 3px 1px 0; white-space: normal; overflow-wrap: anywhere; }
  .objects tr > :nth-child(n+17) { display: none; } .paper { display: block; }
  .objects thead button { white-space: normal; font-size: inherit; overflow-wrap: anywhere; text-align: left; }
  .gallery figure { max-width: 48%; } .filters { display: none; }
  .objects td:first-child, .objects th, .objects th:first-child { position: static; } }
@media (max-width: 40rem) { header, nav { padding-left: 1rem; padding-right: 1rem; }
  dl, .details dl { grid-template-columns: 1fr; } }
"""
"""Inline CSS: light, printable, responsive, without external resources."""

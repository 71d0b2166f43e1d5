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
@media print { nav { display: none; } body { background: #fff; } section { border: 0; break-inside: avoid; } }
@media (max-width: 40rem) { header, nav { padding-left: 1rem; padding-right: 1rem; }
  dl { grid-template-columns: 1fr; } }
"""
"""Inline CSS: light, printable, responsive, without external resources."""

"""Map and table of the objects of an inventory, linked by a script of the page; drawn without a network."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mlsroad_pipeline.reporting.clouds.pictures import MapFrame
from mlsroad_pipeline.reporting.clouds.view import scale_length
from mlsroad_pipeline.reporting.html.report import cell, data_uri, table_html

SCRIPT = Path(__file__).with_name("objects.js").read_text(encoding="utf-8")
"""Script of the map and the table, which loads nothing; texts of the survey reach the page as text, never as HTML."""
KIND_COLOURS = {"pole": "#1f3fae", "sign": "#b3400a", "tree": "#0b6b3a", "vehicle": "#b3125a"}
"""Kind to the colour of its symbols, all legible on white."""
OTHER_COLOURS = ("#5b3fa0", "#00616e", "#6b5300", "#444444", "#8a1c7c", "#2f5d00")
"""Colours of further kinds, in their order."""
SQUARE = ("sign", "vehicle")
"""Kinds drawn as squares; others are dots."""
MOST_OBJECTS = 5000
"""Largest number of objects on the map and in the table; of more, those with the highest scores of each kind."""
_HINT = "Point at an object, or tap it, for its measures."
_LOWEST, _WIDTH, _HIGHEST = 260, 1140, 640  # height and width of the map at first, pixels


def shown_objects(objects: pd.DataFrame) -> pd.DataFrame:
    """Return the objects sorted by kind and score; of many, an equal share of each kind at most."""
    ordered = objects.sort_values(["kind", "score", "object_id"], ascending=[True, False, True], kind="stable")
    if len(ordered) <= MOST_OBJECTS:
        return ordered.reset_index(drop=True)
    share = MOST_OBJECTS // ordered["kind"].nunique()
    return ordered.groupby("kind", sort=False).head(share).reset_index(drop=True)


def kind_colours(kinds: Sequence[str]) -> dict[str, str]:
    """Return the colours of kinds."""
    others = [kind for kind in kinds if kind not in KIND_COLOURS]
    return {kind: KIND_COLOURS.get(kind) or OTHER_COLOURS[others.index(kind) % len(OTHER_COLOURS)] for kind in kinds}


@dataclass(frozen=True)
class ObjectMapSection:
    """Map of the path and the objects."""

    title: str  # The heading
    objects: pd.DataFrame  # Objects with `kind`, `score`, `x`, `y`, as `shown_objects` returns them
    frame: MapFrame  # Frame of the map
    counts: dict[str, int]  # Kind to the number of objects of the inventory
    path: NDArray[np.float64] | None = None  # Positions of the scanner in the order of travel
    background: NDArray[np.uint8] | None = None  # Picture of the whole frame
    # Kind of line to the vertices of each
    lines: Mapping[str, Sequence[NDArray[np.float64]]] = field(default_factory=dict)

    def body(self) -> str:
        """Return the map with its legend, its buttons and the place for the measures of an object."""
        width, height = self.frame.size
        pixels = int(np.clip(_WIDTH * height / width, _LOWEST, _HIGHEST))
        kinds = sorted(self.counts)
        colours = kind_colours(kinds)
        described = ", ".join(f"{count} {kind}{'s' * (count != 1)}" for kind, count in self.counts.items())
        label = escape(f"Map of the survey: {described or 'no objects'}. Arrow keys move it, plus and minus zoom.")
        style = "".join(f"#map .k{n}{{stroke:{colours[kind]}}}" for n, kind in enumerate(kinds))
        return (
            f"<style>{style}</style>\n{self._legend(kinds, colours)}"
            '<div class="map"><div class="map-buttons">'
            '<button type="button" data-zoom="1.6" aria-label="Zoom in">+</button>'
            '<button type="button" data-zoom="0.625" aria-label="Zoom out">&minus;</button>'
            '<button type="button" data-zoom="0" aria-label="Show all">All</button></div>'
            f'<svg id="map" role="img" aria-label="{label}" tabindex="0" viewBox="0 0 {width:.2f} {height:.2f}" '
            f'style="height:{pixels}px" preserveAspectRatio="xMidYMid meet">{self._background()}{self._lines()}'
            f"{self._path()}{self._symbols(kinds)}</svg>{self._north()}{_scale_bar(width)}</div>\n"
            '<div id="object-details" class="details" role="status" aria-live="polite"><p class="none">'
            f"{_HINT if len(self.objects) else 'No objects were found.'}</p></div>\n"
        )

    def _legend(self, kinds: Sequence[str], colours: dict[str, str]) -> str:
        boxes = [
            f'<label><input type="checkbox" checked data-kind="{n}"><i class="{"square" if kind in SQUARE else "dot"}" '
            f'style="background:{colours[kind]}"></i>{escape(kind)} <b>{self.counts[kind]}</b></label>'
            for n, kind in enumerate(kinds)
        ]
        if self.path is not None:
            boxes.append('<label><input type="checkbox" checked data-layer="path"><i class="line"></i>path</label>')
        for kind in self._drawn_lines():
            box = f'<input type="checkbox" checked data-layer="{escape(kind)}s">'
            boxes.append(f'<label>{box}<i class="line {escape(kind)}"></i>{escape(kind.replace("_", " "))}s</label>')
        if self.background is not None:
            boxes.append('<label><input type="checkbox" checked data-layer="cloud">cloud by class</label>')
        return f'<fieldset class="legend"><legend>On the map</legend>{"".join(boxes)}</fieldset>\n'

    def _background(self) -> str:
        if self.background is None:
            return ""
        width, height = self.frame.size
        return (
            f'<image data-layer="cloud" width="{width:.2f}" height="{height:.2f}" preserveAspectRatio="none" '
            f'opacity="0.5" href="{data_uri(self.background)}"/>'
        )

    def _path(self) -> str:
        if self.path is None or len(self.path) < 2:
            return ""
        step = max(1, len(self.path) // 4000)
        kept = np.concatenate([self.path[:-1:step], self.path[-1:]])
        places = " ".join(f"{x:.1f},{y:.1f}" for x, y in self.frame.place(kept))
        return f'<polyline data-layer="path" class="path" points="{places}"/>'

    def _drawn_lines(self) -> dict[str, Sequence[NDArray[np.float64]]]:
        return {kind: lines for kind, lines in self.lines.items() if len(lines)}

    def _lines(self) -> str:
        return "".join(
            f'<path data-layer="{escape(kind)}s" class="{escape(kind)}s" d="{self._moves(lines)}"/>'
            for kind, lines in self._drawn_lines().items()
        )

    def _moves(self, lines: Sequence[NDArray[np.float64]]) -> str:
        placed = [self.frame.place(line).round(2) for line in lines]
        return "".join("M" + "L".join(f"{x:g} {y:g}" for x, y in line) for line in placed)

    def _symbols(self, kinds: Sequence[str]) -> str:
        places = self.frame.place(self.objects[["x", "y"]].to_numpy())
        number = {kind: n for n, kind in enumerate(kinds)}
        drawn = {kind: [] for kind in kinds}  # type: dict[str, list[str]]
        for row, (kind, (x, y)) in enumerate(zip(self.objects["kind"], places, strict=True)):
            drawn[kind].append(f'<path d="M{x:.2f} {y:.2f}h0" data-i="{row}"/>')
        return "".join(
            f'<g class="o k{number[kind]}{" square" if kind in SQUARE else ""}" data-kind="{number[kind]}">'
            f"<title>{escape(kind)}</title>{''.join(found)}</g>"
            for kind, found in drawn.items()
        )

    def _north(self) -> str:
        turn = np.radians(self.frame.north)
        return (
            '<svg class="north" viewBox="-22 -22 44 44" role="img" aria-label="North arrow">'
            f'<path d="M0 -11L5 11L0 7L-5 11Z" transform="rotate({self.frame.north:.1f})"/>'
            f'<text x="{17 * np.sin(turn):.1f}" y="{3 - 17 * np.cos(turn):.1f}" text-anchor="middle">N</text></svg>'
        )


def _scale_bar(width: float) -> str:
    """Return the bar; its length follows the zoom in a browser, and the width of the map without a script."""
    metres = scale_length(width / 5)
    return f'<div class="scale" data-metres="{metres:g}" style="width:{100 * metres / width:.2f}%">{metres:g} m</div>'


def object_data(objects: pd.DataFrame, names: dict[str, str], places: NDArray[np.float64]) -> str:
    """Return the objects as a JSON script element; `names` has the heading of each column that is shown."""
    columns = [name for name in names if name in objects]
    rows = objects[columns].astype(object).where(objects[columns].notna(), None).to_numpy().tolist()
    kinds = sorted(set(objects["kind"]))
    content = {
        "columns": [[name, names[name]] for name in columns],
        "kinds": kinds,
        "rows": rows,
        "places": [[round(float(x), 2), round(float(y), 2)] for x, y in places],
    }
    text = json.dumps(content, ensure_ascii=False, allow_nan=False, separators=(",", ":"), default=str)
    return f'<script type="application/json" id="object-data">{text.replace("<", chr(92) + "u003c")}</script>\n'


FIRST_ROWS = 40
"""Rows that a page shows without a script."""


@dataclass(frozen=True)
class ObjectTableSection:
    """Counts by kind, and all objects with their columns."""

    title: str  # The heading
    objects: pd.DataFrame  # Objects as `shown_objects` returns them
    total: pd.DataFrame  # Number of objects by kind and class
    names: dict[str, str]  # Column to heading, in order
    places: NDArray[np.float64]  # Positions on the map
    geopackage: str = ""  # Path or URL of the GeoPackage, relative to the report

    def body(self) -> str:
        """Return counts, the link, filters and the table."""
        path = escape(self.geopackage, quote=True)
        # URLs such as "javascript:..." must not become links
        safe = not re.match(r"^[A-Za-z][A-Za-z0-9+.\-]*:", self.geopackage) or self.geopackage.startswith("https://")
        target = f'<a href="{path}">{path}</a>' if safe else path
        link = f"<p>All objects as map layers: {target}</p>" if self.geopackage else ""
        script = f"{object_data(self.objects, self.names, self.places)}<script>{SCRIPT}</script>"
        if self.objects.empty:
            return f'{link}<p class="none">No objects were found.</p>{script}'
        every = int(self.total["objects"].sum())
        more = (
            f" The map and the table have {len(self.objects)} of {every} objects." if len(self.objects) < every else ""
        )
        return (
            f"{table_html(self.total)}{link}"
            "<p>Sorted by kind and score; a heading sorts by its column, a number shows the object on the map."
            f"{more}</p>"
            f"{self._filters()}{self._table()}{script}"
        )

    def _filters(self) -> str:
        kinds = "".join(
            f'<option value="{escape(k, quote=True)}">{escape(k)}</option>' for k in sorted(set(self.objects["kind"]))
        )
        return (
            '<form class="filters" id="object-filters" onsubmit="return false">'
            f'<label>Kind <select name="kind"><option value="">all</option>{kinds}</select></label>'
            '<label>Class or number <input name="text" type="search" size="14"></label>'
            '<label>Score from <input name="low" type="number" min="0" max="1" step="0.05" value="0"></label>'
            '<label>to <input name="high" type="number" min="0" max="1" step="0.05" value="1"></label>'
            '<output id="object-count" aria-live="polite"></output></form>'
        )

    def _table(self) -> str:
        columns = [name for name in self.names if name in self.objects]
        heads = "".join(
            f'<th scope="col" aria-sort="none"><button type="button" data-column="{n}">'
            f"{escape(self.names[name])}</button></th>"
            for n, name in enumerate(columns)
        )
        rows = "".join(
            "<tr>" + "".join(f"<td>{cell(value)}</td>" for value in row) + "</tr>"
            for row in self.objects[columns].head(FIRST_ROWS).to_numpy(dtype=object).tolist()
        )
        return (
            '<div class="scroll objects" tabindex="0" role="region" aria-label="Table of objects"><table id="objects">'
            f"<thead><tr>{heads}</tr></thead><tbody>{rows}</tbody></table></div>"
            '<p class="paper">Printed with the first sixteen columns; the files have all.</p>'
            '<p><button type="button" id="object-more" hidden>Show more</button></p>'
        )

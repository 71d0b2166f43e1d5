"""Map and table of the objects of an inventory, linked by a script of the page; drawn without a network."""

import json
import re
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.palette import KIND_COLOURS, LINE_COLOURS, STATE_COLOURS
from mlsroad_pipeline.reporting.clouds.pictures import MapFrame
from mlsroad_pipeline.reporting.clouds.view import scale_length
from mlsroad_pipeline.reporting.html.report import Section, cell, data_uri, table_html

SCRIPT = Path(__file__).with_name("objects.js").read_text(encoding="utf-8")
"""Script of the map and the table, which loads nothing; texts of the survey reach the page as text, never as HTML."""
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
    """Return the colours of kinds, or of states of comparisons."""
    known = KIND_COLOURS | STATE_COLOURS
    others = [kind for kind in kinds if kind not in known]
    return {kind: known.get(kind) or OTHER_COLOURS[others.index(kind) % len(OTHER_COLOURS)] for kind in kinds}


def object_map_section(
    title: str,
    objects: pd.DataFrame,
    frame: MapFrame,
    counts: dict[str, int],
    path: NDArray[np.float64] | None = None,
    background: NDArray[np.uint8] | None = None,
    lines: Mapping[str, Sequence[NDArray[np.float64]]] | None = None,
) -> Section:
    """Return the map of the objects of `shown_objects` with its legend, its buttons and the place for measures.

    `counts` has the number of objects of the whole inventory by kind, `path` the positions of the scanner in the order
    of travel, `background` a picture of the whole frame, `lines` the vertices of each line by kind.
    """
    width, height = frame.size
    pixels = int(np.clip(_WIDTH * height / width, _LOWEST, _HIGHEST))
    colours = kind_colours(sorted(counts))
    described = ", ".join(f"{count} {kind}{'s' * (count != 1)}" for kind, count in counts.items())
    label = escape(f"Map of the survey: {described or 'no objects'}. Arrow keys move it, plus and minus zoom.")
    style = "".join(f"#map .k{n}{{stroke:{colour}}}" for n, colour in enumerate(colours.values()))
    style += "".join(
        f"#map .{kind}s{{stroke:{colour}}}.legend i.{kind}{{background:{colour}}}"
        for kind, colour in LINE_COLOURS.items()
    )
    boxes = [
        f'<label><input type="checkbox" checked data-kind="{n}"><i class="{"square" if kind in SQUARE else "dot"}" '
        f'style="background:{colour}"></i>{escape(kind)} <b>{counts[kind]}</b></label>'
        for n, (kind, colour) in enumerate(colours.items())
    ]
    drawn = ""
    if background is not None:
        drawn = (
            f'<image data-layer="cloud" width="{width:.2f}" height="{height:.2f}" preserveAspectRatio="none" '
            f'opacity="0.5" data-frame="{frame_text(frame)}" href="{data_uri(background)}"/>'
        )
    if path is not None:
        boxes.append('<label><input type="checkbox" checked data-layer="path"><i class="line"></i>path</label>')
    for kind, vertices in (lines or {}).items():
        if len(vertices):
            layer, moves = f"{escape(kind)}s", "".join(_moves(frame.place(line)) for line in vertices)
            box = f'<input type="checkbox" checked data-layer="{layer}"><i class="line {escape(kind)}"></i>'
            boxes.append(f"<label>{box}{escape(kind.replace('_', ' '))}s</label>")
            drawn += f'<path data-layer="{layer}" class="{layer}" d="{moves}"/>'
    if background is not None:
        boxes.append('<label><input type="checkbox" checked data-layer="cloud">cloud by class</label>')
    if path is not None and len(path) > 1:
        kept = np.concatenate([path[: -1 : max(1, len(path) // 4000)], path[-1:]])
        places = " ".join(f"{x:.1f},{y:.1f}" for x, y in frame.place(kept))
        drawn += f'<polyline data-layer="path" class="path" points="{places}"/>'
    return Section(
        title,
        f'<style>{style}</style>\n<fieldset class="legend"><legend>On the map</legend>{"".join(boxes)}</fieldset>\n'
        '<div class="map"><div class="map-buttons">'
        '<button type="button" data-zoom="1.6" aria-label="Zoom in">+</button>'
        '<button type="button" data-zoom="0.625" aria-label="Zoom out">&minus;</button>'
        '<button type="button" data-zoom="0" aria-label="Show all">All</button></div>'
        f'<svg id="map" role="img" aria-label="{label}" tabindex="0" viewBox="0 0 {width:.2f} {height:.2f}" '
        f'style="height:{pixels}px" preserveAspectRatio="xMidYMid meet">{drawn}{_symbols(objects, frame, colours)}'
        f"</svg>{_north(frame.north)}{_scale_bar(width)}</div>\n"
        '<div id="object-details" class="details" role="status" aria-live="polite"><p class="none">'
        f"{_HINT if len(objects) else 'No objects were found.'}</p></div>\n",
    )


def frame_text(frame: MapFrame) -> str:
    """Return the numbers of a frame, by which another picture finds its place."""
    return ",".join(repr(float(value)) for part in frame for value in part)


def _moves(line: NDArray[np.float64]) -> str:
    return "M" + "L".join(f"{x:g} {y:g}" for x, y in line.round(2))


def _symbols(objects: pd.DataFrame, frame: MapFrame, kinds: Iterable[str]) -> str:
    drawn: dict[str, list[str]] = {kind: [] for kind in kinds}
    places = frame.place(objects[["x", "y"]].to_numpy())
    for row, (kind, (x, y)) in enumerate(zip(objects["kind"], places, strict=True)):
        drawn[kind].append(f'<path d="M{x:.2f} {y:.2f}h0" data-i="{row}"/>')
    return "".join(
        f'<g class="o k{n}{" square" if kind in SQUARE else ""}" data-kind="{n}">'
        f"<title>{escape(kind)}</title>{''.join(found)}</g>"
        for n, (kind, found) in enumerate(drawn.items())
    )


def _north(angle: float) -> str:
    turn = np.radians(angle)
    return (
        '<svg class="north" viewBox="-22 -22 44 44" role="img" aria-label="North arrow">'
        f'<path d="M0 -11L5 11L0 7L-5 11Z" transform="rotate({angle:.1f})"/>'
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


def object_table_section(
    title: str,
    objects: pd.DataFrame,
    total: pd.DataFrame,
    names: dict[str, str],
    places: NDArray[np.float64],
    geopackage: str = "",
) -> Section:
    """Return counts by kind and class, the link, filters, and the objects of `shown_objects` at `places` of the map.

    `names` has the headings of the columns, `geopackage` a path or URL relative to the report.
    """
    path = escape(geopackage, quote=True)
    # URLs such as "javascript:..." must not become links
    safe = not re.match(r"^[A-Za-z][A-Za-z0-9+.\-]*:", geopackage) or geopackage.startswith("https://")
    target = f'<a href="{path}">{path}</a>' if safe else path
    link = f"<p>All objects as map layers: {target}</p>" if geopackage else ""
    script = f"{object_data(objects, names, places)}<script>{SCRIPT}</script>"
    if objects.empty:
        return Section(title, f'{link}<p class="none">No objects were found.</p>{script}')
    every = int(total["objects"].sum())
    order = "kind and score" if "score" in objects else names["kind"].lower()
    more = f" The map and the table have {len(objects)} of {every} objects." if len(objects) < every else ""
    return Section(
        title,
        f"{table_html(total)}{link}"
        f"<p>Sorted by {escape(order)}; a heading sorts by its column, a number shows the object on the map.{more}</p>"
        f"{_filters(objects, names)}{_table(objects, names)}{script}",
    )


def _filters(objects: pd.DataFrame, names: Mapping[str, str]) -> str:
    kinds = sorted(set(objects["kind"]))
    scores = (
        '<label>Score from <input name="low" type="number" min="0" max="1" step="0.05" value="0"></label>'
        '<label>to <input name="high" type="number" min="0" max="1" step="0.05" value="1"></label>'
    )
    options = "".join(f'<option value="{escape(kind, quote=True)}">{escape(kind)}</option>' for kind in kinds)
    return (
        '<form class="filters" id="object-filters" onsubmit="return false">'
        f'<label>{escape(names["kind"])} <select name="kind"><option value="">all</option>{options}</select></label>'
        '<label>Class or number <input name="text" type="search" size="14"></label>'
        f"{scores if 'score' in objects else ''}"
        '<output id="object-count" aria-live="polite"></output></form>'
    )


def _table(objects: pd.DataFrame, names: dict[str, str]) -> str:
    columns = [name for name in names if name in objects]
    heads = "".join(
        f'<th scope="col" aria-sort="none"><button type="button" data-column="{n}">{escape(names[name])}</button></th>'
        for n, name in enumerate(columns)
    )
    rows = "".join(
        "<tr>" + "".join(f"<td>{cell(value)}</td>" for value in row) + "</tr>"
        for row in objects[columns].head(FIRST_ROWS).to_numpy(dtype=object).tolist()
    )
    return (
        '<div class="scroll objects" tabindex="0" role="region" aria-label="Table of objects"><table id="objects">'
        f"<thead><tr>{heads}</tr></thead><tbody>{rows}</tbody></table></div>"
        '<p class="paper">Printed with the first sixteen columns; the files have all.</p>'
        '<p><button type="button" id="object-more" hidden>Show more</button></p>'
    )

"""Report of a run as one self-contained HTML file: elements with all inputs escaped, sections, the page."""

from __future__ import annotations

import base64
import io
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pandas as pd
from joblib import cpu_count
from numpy.typing import NDArray
from PIL import Image

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.palette import class_palette, rgb_to_hex

if TYPE_CHECKING:  # a report without figures needs no matplotlib
    from matplotlib.figure import Figure

STYLE = Path(__file__).with_name("report.css").read_text(encoding="utf-8")
"""Inline CSS: light, printable, responsive, without external resources."""


def cell(value: Any) -> str:
    """Format a value: four significant digits, thousands separated, a dash for undefined values."""
    if value is None or value is pd.NaT or (isinstance(value, float | np.floating) and np.isnan(value)):
        return "–"
    if isinstance(value, bool | np.bool_):
        return "yes" if value else "no"
    if isinstance(value, int | np.integer):
        return f"{int(value):,}".replace(",", "\u202f")
    if isinstance(value, float | np.floating):
        number = float(value)
        return f"{number:,.2f}".replace(",", "\u202f") if abs(number) >= 1000 else f"{number:.4g}"
    return escape(str(value))


def table_html(frame: pd.DataFrame) -> str:
    """Return a table as HTML."""
    table = frame.reset_index() if any(name is not None for name in frame.index.names) else frame
    numeric = [pd.api.types.is_numeric_dtype(dtype) for dtype in table.dtypes]
    style = [' class="number"' if number else "" for number in numeric]
    heads = [escape(str(name).replace("_", " ")) for name in table.columns]
    head = "".join(f'<th scope="col"{s}>{name}</th>' for name, s in zip(heads, style, strict=True))
    columns = [table.iloc[:, k].tolist() for k in range(table.shape[1])]
    rows = "".join(
        "<tr>" + "".join(f"<td{s}>{cell(value)}</td>" for value, s in zip(row, style, strict=True)) + "</tr>\n"
        for row in zip(*columns, strict=True)
    )
    return f'<div class="scroll"><table><thead><tr>{head}</tr></thead>\n<tbody>{rows}</tbody></table></div>'


def note(text: str) -> str:
    """Return a paragraph, empty for no text."""
    return f"<p>{escape(text)}</p>" if text else ""


def data_uri(figure: Figure | NDArray[np.uint8]) -> str:
    """Return a figure or picture as a data URI: WebP in base64."""
    picture = figure if isinstance(figure, np.ndarray) else figure_pixels(figure)
    if picture.dtype != np.uint8 or picture.ndim != 3 or picture.shape[2] != 3:
        raise DataError(f"a picture must be uint8 of shape (height, width, 3), got {picture.dtype} {picture.shape}")
    buffer = io.BytesIO()
    # For pictures of clouds a third of the size of lossless WebP in a fifth of the time, visually identical.
    Image.fromarray(picture).save(buffer, format="WEBP", quality=90, method=1)
    return "data:image/webp;base64," + base64.b64encode(buffer.getvalue()).decode("ascii")


def figure_pixels(figure: Figure) -> NDArray[np.uint8]:
    """Render a figure into an array."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="raw")
    width, height = figure.canvas.get_width_height()
    return np.frombuffer(buffer.getvalue(), dtype=np.uint8).reshape(height, width, 4)[:, :, :3].copy()


class Section(NamedTuple):
    """Section of a report: the heading, and the HTML below it with all inputs escaped."""

    title: str
    body: str


_NOTHING = '<p class="none">Nothing to show.</p>'


def facts_section(title: str, facts: Mapping[str, Any]) -> Section:
    """Return names and values, such as the model and the data of a run."""
    items = (f"<dt>{escape(str(name))}</dt><dd>{cell(value)}</dd>" for name, value in facts.items())
    return Section(title, f"<dl>{''.join(items)}</dl>")


def table_section(title: str, table: pd.DataFrame, above: str = "", *, largest: int = 500) -> Section:
    """Return the first rows of a table, and the number of omitted ones, with a sentence above."""
    left_out = len(table) - largest
    more = f'<p class="none">{left_out} more rows are omitted.</p>' if left_out > 0 else ""
    return Section(title, note(above) + (_NOTHING if table.empty else table_html(table.head(largest)) + more))


def figures_section(title: str, figures: Mapping[str, Figure | NDArray[np.uint8]]) -> Section:
    """Return figures and pictures by their captions, embedded."""
    pictures = [figure if isinstance(figure, np.ndarray) else figure_pixels(figure) for figure in figures.values()]
    with ThreadPoolExecutor(max_workers=cpu_count()) as pool:  # encoding releases the GIL
        addresses = list(pool.map(data_uri, pictures))
    shown = (
        f'<figure><img alt="{escape(caption, quote=True)}" src="{address}">'
        f"<figcaption>{escape(caption)}</figcaption></figure>\n"
        for caption, address in zip(figures, addresses, strict=True)
    )
    return Section(title, "".join(shown))


def scene_section(title: str, pictures: Mapping[str, NDArray[np.uint8]], colours: Mapping[str, Any]) -> Section:
    """Return pictures of a part of the survey by their captions, with the colours of the classes."""
    if not pictures:
        return Section(title, _NOTHING)
    keys = "".join(
        f'<li><i style="background:{rgb_to_hex(colour)}"></i>{escape(name.replace("_", " "))}</li>'
        for name, colour in colours.items()
    )
    return Section(title, f'<ul class="keys">{keys}</ul>' + figures_section(title, pictures).body)


def distribution_section(title: str, counts: Mapping[str, int], scheme: ClassScheme | None = None) -> Section:
    """Return the numbers of points per class as bars in the colours of the pictures.

    `counts` are in label order and may contain a class ``"unlabelled"``; without a scheme the colours follow the names.
    """
    total = sum(counts.values())
    colours = dict(zip(counts, class_palette(tuple(counts)), strict=False))
    if scheme is not None:
        colours |= zip(scheme.classes, class_palette(scheme), strict=False)
    rows = []
    for name, count in counts.items():
        colour = rgb_to_hex(colours[name])
        share = count / total if total else 0.0
        rows.append(
            f'<tr><th scope="row"><i style="background:{colour}"></i>'
            f'{escape(name.replace("_", " "))}</th><td class="number">{cell(int(count))}</td>'
            f'<td class="number">{100 * share:.2f} %</td>'
            f'<td class="bar"><b style="width:{100 * share:.2f}%;background:{colour}"></b></td></tr>\n'
        )
    head = '<th scope="col">class</th><th class="number">points</th><th class="number">share</th><th></th>'
    return Section(title, f"<table><thead><tr>{head}</tr></thead><tbody>{''.join(rows)}</tbody></table>")


def warnings_section(title: str, messages: Sequence[str]) -> Section:
    """Return warnings on the data or the run."""
    items = "".join(f"<li>{escape(message)}</li>" for message in messages)
    return Section(title, f'<ul class="warnings">{items}</ul>' if items else '<p class="none">None.</p>')


class Picture(NamedTuple):
    """Picture, uint8 of shape (height, width, 3), with its caption."""

    pixels: NDArray[np.uint8]
    caption: str


def gallery_section(title: str, groups: Mapping[str, Sequence[Picture]], above: str = "") -> Section:
    """Return small pictures in rows, under a heading per group, with a sentence above."""
    rows = "".join(_group(name, pictures) for name, pictures in groups.items() if pictures)
    return Section(title, note(above) + (rows or _NOTHING))


def _group(name: str, pictures: Sequence[Picture]) -> str:
    shown = "".join(
        f'<figure><img alt="{escape(picture.caption, quote=True)}" '
        f'width="{picture.pixels.shape[1]}" height="{picture.pixels.shape[0]}" src="{data_uri(picture.pixels)}">'
        f"<figcaption>{escape(picture.caption)}</figcaption></figure>\n"
        for picture in pictures
    )
    return f'<h3>{escape(name)}</h3>\n<div class="gallery">{shown}</div>\n'


def build_report(sections: Sequence[Section], *, title: str = "Survey report", subtitle: str = "") -> str:
    """Return one HTML page of all sections, with embedded style and pictures.

    Examples
    --------
    >>> page = build_report([warnings_section("Warnings", ["no colour in <a.laz>"])])
    >>> "no colour in &lt;a.laz&gt;" in page
    True
    """
    links = "".join(f'<a href="#s{k}">{escape(s.title)}</a>' for k, s in enumerate(sections))
    parts = "".join(
        f'<section id="s{k}"><h2>{escape(section.title)}</h2>\n{section.body}</section>\n'
        for k, section in enumerate(sections)
    )
    under = f"<p>{escape(subtitle)}</p>" if subtitle else ""
    return (
        f'<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"><title>{escape(title)}</title>\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<style>{STYLE}</style></head>\n<body><header><h1>{escape(title)}</h1>{under}</header>\n"
        f"<nav>{links}</nav>\n<main>\n{parts}</main></body></html>\n"
    )

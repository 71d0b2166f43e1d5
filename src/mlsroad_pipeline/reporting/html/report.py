"""Report of a run as one self-contained HTML file: elements with all inputs escaped, sections, the page."""

from __future__ import annotations

import base64
import io
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

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


@dataclass(frozen=True)
class FactsSection:
    """Names and values, such as the model and the data of a run."""

    title: str  # The heading
    facts: Mapping[str, Any]  # Names and values, in order

    def body(self) -> str:
        """Return a description list."""
        items = (f"<dt>{escape(str(name))}</dt><dd>{cell(value)}</dd>" for name, value in self.facts.items())
        return f"<dl>{''.join(items)}</dl>"


@dataclass(frozen=True)
class TableSection:
    """Table, such as the survey quality per file or the scores."""

    title: str  # The heading
    table: pd.DataFrame  # The table
    note: str = ""  # A sentence above it
    largest: int = 500  # Maximum number of rows; a note gives the number of omitted rows

    def body(self) -> str:
        """Return the note and the table."""
        if self.table.empty:
            return note(self.note) + '<p class="none">Nothing to show.</p>'
        left_out = len(self.table) - self.largest
        more = f'<p class="none">{left_out} more rows are omitted.</p>' if left_out > 0 else ""
        return note(self.note) + table_html(self.table.head(self.largest)) + more


@dataclass(frozen=True)
class FiguresSection:
    """Figures and pictures with captions."""

    title: str  # The heading
    figures: Mapping[str, Figure | NDArray[np.uint8]]  # Caption to figure or picture

    def body(self) -> str:
        """Return the figures, embedded."""
        drawn = self.figures.values()
        pictures = [figure if isinstance(figure, np.ndarray) else figure_pixels(figure) for figure in drawn]
        with ThreadPoolExecutor(max_workers=cpu_count()) as pool:  # encoding releases the GIL
            addresses = list(pool.map(data_uri, pictures))
        return "".join(
            f'<figure><img alt="{escape(caption, quote=True)}" src="{address}">'
            f"<figcaption>{escape(caption)}</figcaption></figure>\n"
            for caption, address in zip(self.figures, addresses, strict=True)
        )


@dataclass(frozen=True)
class SceneSection:
    """Pictures of a part of the survey with the colours of the classes."""

    title: str  # The heading
    pictures: Mapping[str, NDArray[np.uint8]]  # Caption to picture
    colours: Mapping[str, Any]  # Class to colour

    def body(self) -> str:
        """Return the key of the colours and the pictures."""
        if not self.pictures:
            return '<p class="none">Nothing to show.</p>'
        keys = "".join(
            f'<li><i style="background:{rgb_to_hex(colour)}"></i>{escape(name.replace("_", " "))}</li>'
            for name, colour in self.colours.items()
        )
        return f'<ul class="keys">{keys}</ul>' + FiguresSection(self.title, self.pictures).body()


@dataclass(frozen=True)
class DistributionSection:
    """Numbers of points per class as bars in the colours of the pictures."""

    title: str  # The heading
    counts: Mapping[str, int]  # Class to number of points, in label order; may contain a class ``"unlabelled"``
    note: str = ""  # A sentence above the bars
    scheme: ClassScheme | None = None  # Scheme of the colours; None derives them from the names

    def body(self) -> str:
        """Return one bar per class."""
        total = sum(self.counts.values())
        colours = dict(zip(self.counts, class_palette(tuple(self.counts)), strict=False))
        if self.scheme is not None:
            colours |= zip(self.scheme.classes, class_palette(self.scheme), strict=False)
        rows = []
        for name, count in self.counts.items():
            colour = colours[name]
            share = count / total if total else 0.0
            rows.append(
                f'<tr><th scope="row"><i style="background:{rgb_to_hex(colour)}"></i>'
                f'{escape(name.replace("_", " "))}</th><td class="number">{cell(int(count))}</td>'
                f'<td class="number">{100 * share:.2f} %</td>'
                f'<td class="bar"><b style="width:{100 * share:.2f}%;background:{rgb_to_hex(colour)}"></b></td></tr>\n'
            )
        head = '<th scope="col">class</th><th class="number">points</th><th class="number">share</th><th></th>'
        return note(self.note) + f"<table><thead><tr>{head}</tr></thead><tbody>{''.join(rows)}</tbody></table>"


@dataclass(frozen=True)
class WarningsSection:
    """Warnings on the data or the run."""

    title: str  # The heading
    messages: Sequence[str] = field(default_factory=tuple)  # Messages; an empty list is reported as "None"

    def body(self) -> str:
        """Return the messages as a list."""
        if not self.messages:
            return '<p class="none">None.</p>'
        return '<ul class="warnings">' + "".join(f"<li>{escape(m)}</li>" for m in self.messages) + "</ul>"


class Picture(NamedTuple):
    """Picture, uint8 of shape (height, width, 3), with its caption."""

    pixels: NDArray[np.uint8]
    caption: str


@dataclass(frozen=True)
class GallerySection:
    """Small pictures in rows, under a heading per group."""

    title: str  # The heading
    groups: Mapping[str, Sequence[Picture]]  # Heading to pictures, in order
    note: str = ""  # A sentence above them

    def body(self) -> str:
        """Return the pictures, embedded."""
        if not any(self.groups.values()):
            return note(self.note) + '<p class="none">Nothing to show.</p>'
        return note(self.note) + "".join(_group(name, pictures) for name, pictures in self.groups.items() if pictures)


def _group(name: str, pictures: Sequence[Picture]) -> str:
    shown = "".join(
        f'<figure><img alt="{escape(picture.caption, quote=True)}" '
        f'width="{picture.pixels.shape[1]}" height="{picture.pixels.shape[0]}" src="{data_uri(picture.pixels)}">'
        f"<figcaption>{escape(picture.caption)}</figcaption></figure>\n"
        for picture in pictures
    )
    return f'<h3>{escape(name)}</h3>\n<div class="gallery">{shown}</div>\n'


class Section(Protocol):
    """Section of a report."""

    @property
    def title(self) -> str:
        """Return the heading."""
        ...

    def body(self) -> str:
        """Return the HTML below the heading, with all inputs escaped."""
        ...


def build_report(sections: Sequence[Section], *, title: str = "Survey report", subtitle: str = "") -> str:
    """Return one HTML page of all sections, with embedded style and pictures.

    Examples
    --------
    >>> page = build_report([WarningsSection("Warnings", ["no colour in <a.laz>"])])
    >>> "no colour in &lt;a.laz&gt;" in page
    True
    """
    links = "".join(f'<a href="#s{k}">{escape(s.title)}</a>' for k, s in enumerate(sections))
    parts = "".join(
        f'<section id="s{k}"><h2>{escape(section.title)}</h2>\n{section.body()}</section>\n'
        for k, section in enumerate(sections)
    )
    under = f"<p>{escape(subtitle)}</p>" if subtitle else ""
    return (
        f'<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"><title>{escape(title)}</title>\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<style>{STYLE}</style></head>\n<body><header><h1>{escape(title)}</h1>{under}</header>\n"
        f"<nav>{links}</nav>\n<main>\n{parts}</main></body></html>\n"
    )

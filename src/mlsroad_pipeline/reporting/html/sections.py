"""Sections of a report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from joblib import cpu_count
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.core.palette import class_palette, rgb_to_hex
from mlsroad_pipeline.reporting.html.parts import cell, data_uri, figure_pixels, note, table_html

if TYPE_CHECKING:
    from matplotlib.figure import Figure


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

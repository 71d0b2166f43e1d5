"""Report of a run as one self-contained HTML file."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from typing import Protocol

from mlsroad_pipeline.reporting.html.sections import (
    DistributionSection,
    FactsSection,
    FiguresSection,
    TableSection,
    WarningsSection,
)
from mlsroad_pipeline.reporting.html.style import STYLE

__all__ = [
    "DistributionSection",
    "FactsSection",
    "FiguresSection",
    "Section",
    "TableSection",
    "WarningsSection",
    "build_report",
]


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

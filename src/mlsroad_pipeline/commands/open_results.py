"""Command `mlsroad open`: the report of a labelled survey in the browser."""

from __future__ import annotations

import webbrowser
from pathlib import Path
from typing import Annotated

import typer

from mlsroad_pipeline.commands.options import default_output, expanded

REPORTS = ("report.html", "inspection.html")
"""Reports of `label` and of `inspect`, the first that exists is opened."""


def open_results(
    results: Annotated[str, typer.Argument(metavar="FOLDER", help="Folder of results, or the labelled survey.")],
    browser: Annotated[bool, typer.Option("--browser/--no-browser", help="Start a browser.")] = True,
) -> None:
    """Open the report of a labelled survey in the browser."""
    from mlsroad_pipeline.algorithms.core.exceptions import ReadError
    from mlsroad_pipeline.commands.errors import one_line_errors

    with one_line_errors(verbose=False):
        place = Path(expanded([results])[0])
        folders = (place, default_output([str(place)]))
        report = next((folder / name for folder in folders for name in REPORTS if (folder / name).is_file()), None)
        if report is None:
            raise ReadError(f"{place} holds no {' or '.join(REPORTS)}: label the survey first (mlsroad label FILE)")
    typer.echo(str(report))
    if browser and not webbrowser.open(report.as_uri()):
        typer.echo("No browser was found: open this file in one.", err=True)

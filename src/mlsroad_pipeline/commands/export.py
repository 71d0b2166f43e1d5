"""Command `mlsroad export`: the corrected inventory and points of a labelled survey, and the protocol of its check."""

import os
from pathlib import Path
from typing import Annotated

import typer

from mlsroad_pipeline.commands.console import (
    collected_warnings,
    one_line_errors,
    output_console,
    print_warnings,
    shown_path,
)
from mlsroad_pipeline.commands.options import Verbose, check_exist, expanded, results_folder


def export(
    out: Annotated[str, typer.Argument(metavar="OUT", help="Folder of results of label, or the labelled survey.")],
    more: Annotated[list[str] | None, typer.Argument(metavar="[FILE]...", help="Further files to write.")] = None,
    output: Annotated[
        list[str] | None,
        typer.Option(
            "--output",
            "-o",
            metavar="FILE...",
            help="Files to write: .gpkg, .parquet, .csv, .geojson, .fgb, .shp, .gml, .dxf, .xodr; .laz, or a folder "
            "for the points of several files; .vpc or .stac.json to name the files; .html for the protocol of the "
            "check. Default: OUT/corrected.gpkg.",
        ),
    ] = None,
    checked: Annotated[bool, typer.Option("--checked", help="Leave out what nobody looked at.")] = False,
    within: Annotated[
        float | None, typer.Option(min=0.0, metavar="METRES", help="Leave out what is farther from the path.")
    ] = None,
    schema: Annotated[
        str | None, typer.Option(metavar="FILE.yml", help="Layers, fields and codes of your own for inventories.")
    ] = None,
    keep_rejected: Annotated[
        bool, typer.Option("--keep-rejected", help="Keep rejected and merged objects, with their status.")
    ] = False,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace files that exist.")] = False,
    verbose: Verbose = False,
) -> None:
    """Write the corrected inventory and points of a labelled survey, and the protocol of its check.

    Nothing is labelled again, and the results of label stay as they are.
    """
    with one_line_errors(verbose=verbose):
        folder = Path(results_folder(expanded([out])[0]))
        check_exist([str(folder)])
        names = [*(output or []), *(more or [])]
        if more and not output:
            raise typer.BadParameter("name the files to write after -o", param_hint="FILE")
        from mlsroad_pipeline.review.corrections.line_decisions import lost_lines
        from mlsroad_pipeline.review.delivery.files import Delivery

        targets = [_target(name) for name in names] or [folder / "corrected.gpkg"]
        with collected_warnings(verbose=verbose) as logged:
            own = None if schema is None else Path(expanded([schema])[0])
            delivery = Delivery(folder, keep_rejected=keep_rejected, checked=checked, within=within, schema=own)
            written = delivery.write(targets, overwrite=overwrite)
        console = output_console()
        states = delivery.states
        kept, listed = len(delivery.corrected.objects), len(delivery.listed.objects)
        console.print(
            f"{kept} objects, {listed} were listed. Decisions about {len(states.of_objects)} objects, "
            f"{len(states.added)} added objects, {len(states.painted)} strokes, {len(states.lines)} about lines, "
            f"{len(states.notes)} notes.",
            markup=False,
        )
        for path in written:
            console.print(f"  {shown_path(path)}", markup=False)
        print_warnings(
            console, [*logged, *_lost(len(states.unmatched) + len(lost_lines(states.lines, folder)), folder)]
        )


def _target(name: str) -> Path:
    """Return a file to write; a folder stands for the points of all files."""
    from mlsroad_pipeline.review.delivery.files import ALL_POINTS

    path = Path(expanded([name])[0])
    return path / ALL_POINTS if name.endswith(os.sep) or path.is_dir() else path


def _lost(count: int, folder: Path) -> list[str]:
    return (
        [f"{count} decisions match no object or line: mlsroad corrections list {shown_path(folder)}"] if count else []
    )

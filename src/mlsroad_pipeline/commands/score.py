"""Command `mlsroad score`: an inventory against a table of true objects."""

from pathlib import Path
from typing import Annotated, Any

import typer

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.commands.console import (
    collected_warnings,
    count_table,
    one_line_errors,
    output_console,
    print_warnings,
    shown_path,
)
from mlsroad_pipeline.commands.options import (
    Params,
    Verbose,
    check_exist,
    expanded,
    literal,
    nested,
    results_folder,
)
from mlsroad_pipeline.commands.session import configure, find_place, run_pipeline
from mlsroad_pipeline.execution.parameter_checks import merged

SCORES = "object_scores.json"
"""File that marks a folder of scores."""


def score(  # typer reads the options from the signature
    inventory: Annotated[
        str, typer.Argument(metavar="INVENTORY", help="Folder of results of label, or a .gpkg or .parquet file.")
    ],
    truth: Annotated[
        str, typer.Option("--truth", metavar="TRUTH", help="Table of true objects, or folder of a simulated street.")
    ],
    output: Annotated[
        str | None,
        typer.Option(
            "--output", "-o", metavar="FOLDER", help="Folder of the scores. Default: scores beside INVENTORY."
        ),
    ] = None,
    cloud: Annotated[
        list[str] | None,
        typer.Option("--cloud", metavar="FILE", help="Labelled cloud. Default: the LAZ files beside INVENTORY."),
    ] = None,
    recall_only: Annotated[
        list[str] | None,
        typer.Option("--recall-only", metavar="KIND", help="Kind whose truth is incomplete, such as tree."),
    ] = None,
    least_score: Annotated[float | None, typer.Option(help="Score only objects with at least this score.")] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace earlier scores in the folder.")] = False,
    params: Params = None,
    verbose: Verbose = False,
) -> None:
    """Score an inventory against true objects: precision, recall and F per kind, calibration, errors of measures.

    Writes tables, a JSON file and a page with pictures of the worst objects.
    """

    given = {"score.inventory": "INVENTORY", "score.truth": "--truth", "score.output": "--output"}
    changed = nested(params or [], given=given)
    with one_line_errors(verbose=verbose):
        places = expanded([inventory, truth, *(cloud or [])])
        places[0] = results_folder(places[0])
        check_exist(places)
        folder = _folder_of_scores(Path(places[0]), output, overwrite=overwrite)
        named = {"inventory": places[0], "truth": places[1], "output": str(folder)}
        values: dict[str, Any] = {name: literal(place) for name, place in named.items()}
        options = {"clouds": places[2:] or None, "recall_only": recall_only or None, "least_score": least_score}
        values |= {name: value for name, value in options.items() if value is not None}
        place = find_place()
        configure(place)
        with collected_warnings(verbose=verbose) as logged:
            run = run_pipeline("score", merged({"score": values}, changed), place=place)
        print_scores(output_console(), run.catalog.load("object_scores_record"), folder)
        print_warnings(output_console(), logged)


def _folder_of_scores(inventory: Path, output: str | None, *, overwrite: bool) -> Path:
    """Return the folder to write scores to; an error if it holds scores that may not be replaced."""

    beside = inventory if inventory.is_dir() else inventory.parent
    folder = beside / "scores" if output is None else Path(expanded([output])[0])
    if (folder / SCORES).exists() and not overwrite:
        raise ParameterError(
            f"{folder} holds scores: name another folder with --output, or replace them with --overwrite"
        )
    return folder


def print_scores(console: Any, record: dict[str, Any], folder: Path) -> None:
    """Print the scores by kind, the errors of position, and the path of the page."""

    columns = ("kind", "true", "found", "listed", "right", "false", "precision", "recall", "F", "calibration error")
    names = ("precision", "recall", "f_score", "calibration_error")
    rows = [
        (
            *(f"{row[name]}" for name in columns[:6]),
            *("" if row[name] is None else f"{row[name]:.3f}" for name in names),
        )
        for row in record["scores"]
    ]
    console.print(count_table(rows, columns))
    measures = [
        (
            row["kind"],
            row["measure"],
            f"{row['n']}",
            *(f"{row[x]:.2f} {row['unit']}" for x in ("median", "quantile_90")),
        )
        for row in record["measures"]
    ]
    if measures:
        console.print()
        console.print(count_table(measures, ("kind", "error of", "objects", "median", "90 %")))
    console.print(f"\nPage: {shown_path(folder / 'object_scores.html')}")

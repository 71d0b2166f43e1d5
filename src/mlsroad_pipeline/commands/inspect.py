"""Command `mlsroad inspect`: a quality report of a survey, before it is labelled."""

from pathlib import Path
from typing import Any

from mlsroad_pipeline.algorithms.core.exceptions import ReadError
from mlsroad_pipeline.commands.console import (
    collected_warnings,
    count_table,
    one_line_errors,
    output_console,
    print_warnings,
    shown_path,
)
from mlsroad_pipeline.commands.options import (
    Output,
    Params,
    Surveys,
    Verbose,
    check_exist,
    default_output,
    expanded,
    literal,
    nested,
    survey_of,
)
from mlsroad_pipeline.commands.session import configure, find_place, run_pipeline
from mlsroad_pipeline.execution.parameter_checks import merged

MOST_PAIRS = 12
"""Largest number of pairs of files or passes that are printed; inspection.json has all."""


def inspect(files: Surveys, output: Output = None, params: Params = None, verbose: Verbose = False) -> None:
    """Report the quality of point clouds: extent, density, attributes, coordinate system, gaps, warnings."""
    changed = nested(params or [], given={"inspect.survey": "FILE", "inspect.output": "--output"})
    with one_line_errors(verbose=verbose):
        places = expanded(files)
        check_exist(places)
        folder = default_output(places) if output is None else Path(expanded([output])[0])
        parameters = {"inspect": {"survey": survey_of(places), "output": literal(str(folder))}}
        place = find_place()
        configure(place)
        with collected_warnings(verbose=verbose):
            run = run_pipeline("inspect", merged(parameters, changed), place=place)
        facts = run.catalog.load("inspection")
        if not facts["files"] and facts["warnings"]:
            said = [row["warning"].removeprefix("cannot be read: ") for row in facts["warnings"]]
            raise ReadError(said[0] + (f" (and {len(said) - 1} more)" if len(said) > 1 else ""))
        print_facts(output_console(), facts, folder / "inspection.html")


def print_offsets(console: Any, offsets: list[dict[str, Any]]) -> None:
    """Print where files and passes lie relative to others where they overlap."""
    if offsets:
        console.print("\nWhere files or passes overlap, metres (blank: nothing measures it):")
        shown = [["" if row[key] is None else f"{row[key]:+.3f}" for key in ("east", "north", "up")] for row in offsets]
        rows = [(row["file"], row["other"], *values) for row, values in zip(offsets, shown, strict=True)]
        console.print(count_table(rows[:MOST_PAIRS], ("lies", "relative to", "east", "north", "up")))


def print_facts(console: Any, facts: dict[str, Any], report: Path) -> None:
    """Print the number of points, one line per file, warnings and the path of the report."""
    files = facts["files"]
    console.print(f"{facts['n_points']:,} points in {len(files)} file{'s' * (len(files) != 1)}.\n")
    density = [f"{file['density']:.0f}" if file["density"] else "" for file in files]
    rows = [
        (file["file"], f"{file['n_points']:,}", per_area, file["crs_name"] or "none")
        for file, per_area in zip(files, density, strict=True)
    ]
    console.print(count_table(rows, ("file", "points", "points per m²", "coordinate system")))
    print_offsets(console, facts["offsets"])
    print_warnings(console, [f"{row['file']}: {row['warning']}" for row in facts["warnings"]])
    console.print(f"\nReport: {shown_path(report)}")

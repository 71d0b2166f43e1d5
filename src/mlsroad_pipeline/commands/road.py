"""Command `mlsroad road`: measures of the road of a labelled survey."""

import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mlsroad_pipeline.commands.console import (
    collected_warnings,
    count_table,
    one_line_errors,
    output_console,
    print_warnings,
    shown_path,
)
from mlsroad_pipeline.commands.options import Verbose, check_exist, expanded, results_folder
from mlsroad_pipeline.commands.session import configure, find_place

if TYPE_CHECKING:
    from mlsroad_pipeline.label.road import MeasuredRoad

_ENVELOPE = re.compile(r"(\d+(?:\.\d+)?)x(\d+(?:\.\d+)?)")


def road(  # typer reads the options from the signature
    survey: Annotated[str, typer.Argument(metavar="FOLDER", help="Folder of results of label.")],
    envelope: Annotated[
        str | None,
        typer.Option("--envelope", metavar="WxH", help="Width and height to keep free around the path, metres."),
    ] = None,
    at: Annotated[
        str | None,
        typer.Option("--at", metavar="STATIONS", help="Stations of sections across the road, such as 120,240."),
    ] = None,
    path: Annotated[
        str | None, typer.Option("--path", metavar="FILE", help="Trajectory to measure along. Default: the survey's.")
    ] = None,
    output: Annotated[
        str | None, typer.Option("--output", "-o", metavar="FOLDER", help="Folder of the measures. Default: road.")
    ] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace earlier measures in the folder.")] = False,
    verbose: Verbose = False,
) -> None:
    """Measure width, crossfall, slope, ruts, evenness and clearance of the road, and draw sections across it."""
    size, stations = _envelope(envelope), _stations(at)
    with one_line_errors(verbose=verbose):
        places = expanded([survey, *([] if path is None else [path])])
        folder = results_folder(places[0])
        check_exist([folder, *places[1:]])
        target = Path(folder) / "road" if output is None else Path(expanded([output])[0])
        configure(find_place())
        from mlsroad_pipeline.label.road import measure_road
        from mlsroad_pipeline.label.road_output import check_target, write_measures
        from mlsroad_pipeline.review.corrections.labelled_output import LabelledOutput
        from mlsroad_pipeline.review.delivery.files import Delivery
        from mlsroad_pipeline.surveys.trajectory_files import read_trajectory

        check_target(target, overwrite=overwrite)
        with collected_warnings(verbose=verbose) as logged:
            labelled, inventory = LabelledOutput.at(folder), Delivery(Path(folder)).corrected
            along = read_trajectory(places[1], crs=inventory.crs) if path is not None else None
            found = measure_road(labelled, inventory, trajectory=along, envelope=size, at=stations)
            written = write_measures(found, target, survey=labelled, envelope=envelope)
        print_road(output_console(), found)
        print_warnings(output_console(), logged)
        for place in written:
            output_console().print(f"  {shown_path(place)}", markup=False)


def _envelope(text: str | None) -> tuple[float, float] | None:
    found = None if text is None else _ENVELOPE.fullmatch(text.strip())
    if text is None:
        return None
    size = (0.0, 0.0) if found is None else (float(found[1]), float(found[2]))
    if not (0.5 <= size[0] <= 20.0 and 0.5 <= size[1] <= 12.0):
        raise typer.BadParameter(
            f"{text!r} must be width x height in metres, such as 4.5x3.5, from 0.5 to 20 and 12 m",
            param_hint="--envelope",
        )
    return size


def _stations(text: str | None) -> list[float]:
    parts = [] if text is None else [part.strip() for part in text.split(",")]
    wrong = next((part for part in parts if re.fullmatch(r"\d+(\.\d+)?", part) is None), None)
    if wrong is not None:
        raise typer.BadParameter(f"{wrong!r} is not a station: give metres such as 120,240", param_hint="--at")
    return sorted({float(part) for part in parts})


def print_road(console: Any, found: "MeasuredRoad") -> None:
    """Print length, medians and shares of the measures."""
    table = found.table
    rows = [
        (name, f"{table[name].median():.2f}", f"{table[name].min():.2f}", f"{table[name].max():.2f}",
         f"{100 * table[name].notna().mean():.0f} %")
        for name in ("width", "crossfall", "slope", "rut_left", "rut_right", "evenness", "clearance")
        if table[name].notna().any()
    ]  # fmt: skip
    console.print(f"Measured {len(table)} m of road.\n")
    console.print(count_table(rows, ("measure", "median", "least", "largest", "seen")))
    if (table["envelope"] != "").any():
        console.print(f"\nThe envelope is intruded in {(table['envelope'] == 'intruded').sum()} m.")

"""Command `mlsroad compare`: a register, or an earlier survey, against a labelled survey."""

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.commands.compare_surveys import SurveyOptions, compare_two_surveys
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
    from mlsroad_pipeline.label.register import ComparedRegister


def compare(  # typer reads the options from the signature
    register: Annotated[
        str,
        typer.Argument(
            metavar="REGISTER",
            help="CSV, GeoPackage, Shapefile, GeoJSON; or the folder of results of an earlier survey.",
        ),
    ],
    survey: Annotated[str, typer.Argument(metavar="FOLDER", help="Folder of results of label.")],
    column: Annotated[
        list[str] | None,
        typer.Option("--column", metavar="COLUMN=NAME", help="Name of id, kind, x, y or height in the register."),
    ] = None,
    value: Annotated[
        list[str] | None,
        typer.Option(
            "--value", metavar="VALUE=KIND", help="Kind of a value: pole, sign or tree; - leaves its entries out."
        ),
    ] = None,
    kind: Annotated[str | None, typer.Option("--kind", metavar="KIND", help="Kind of all entries.")] = None,
    layer: Annotated[str | None, typer.Option("--layer", metavar="NAME", help="Layer of the register.")] = None,
    crs: Annotated[
        str | None, typer.Option("--crs", metavar="EPSG:...", help="Coordinate system of the register.")
    ] = None,
    output: Annotated[
        str | None,
        typer.Option("--output", "-o", metavar="FOLDER", help="Folder of the states. Default: register, or changes."),
    ] = None,
    align: Annotated[
        bool, typer.Option("--align", help="Move the earlier survey by its offset, which is measured in any case.")
    ] = False,
    surfaces: Annotated[
        bool, typer.Option("--surfaces/--no-surfaces", help="Compare road, kerbs and facades of two surveys.")
    ] = True,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace earlier states in the folder.")] = False,
    verbose: Verbose = False,
) -> None:
    """Say what is confirmed, moved, gone, not visible or new: of a register, or of an earlier survey."""
    with one_line_errors(verbose=verbose):
        places = expanded([register, survey])
        folder, earlier = results_folder(places[1]), results_folder(places[0])
        if os.path.isdir(earlier):
            of_register = {"--column": column, "--value": value, "--kind": kind, "--layer": layer, "--crs": crs}
            given = next((name for name, option in of_register.items() if option), None)
            if given is not None:
                raise ParameterError(f"{given} is for a register, and {places[0]} is a survey: leave it out")
            target = Path(folder) / "changes" if output is None else Path(expanded([output])[0])
            options = SurveyOptions(align, surfaces, overwrite, verbose)
            compare_two_surveys(earlier, folder, target, options)
            return
        check_exist([places[0], folder])
        from mlsroad_pipeline.surveys.register_files import RegisterFile, is_point_cloud

        if is_point_cloud(places[0]):
            raise ParameterError(f"{places[0]} has no results of label: label it first (mlsroad label {places[0]})")
        if align or not surfaces:
            raise ParameterError(
                f"{'--align' if align else '--no-surfaces'} is for two surveys, and {places[0]} is a register: leave "
                "it out"
            )
        target = Path(folder) / "register" if output is None else Path(expanded([output])[0])
        configure(find_place())
        from mlsroad_pipeline.label.register import LAYER, PAGE, TABLE, compare_register, write_compared
        from mlsroad_pipeline.label.result_files import check_target
        from mlsroad_pipeline.review.corrections.labelled_output import LabelledOutput
        from mlsroad_pipeline.review.delivery.files import Delivery

        if os.path.realpath(places[0]) in {os.path.realpath(target / name) for name in (TABLE, LAYER, PAGE)}:
            raise ParameterError(f"{places[0]} is the register to compare: name another folder with --output")
        if any((target / name).exists() for name in (TABLE, LAYER, PAGE)) and not overwrite:
            raise ParameterError(
                f"{target} holds the states of a register: name another folder with --output, or replace them with "
                "--overwrite"
            )
        labelled = LabelledOutput.at(folder)
        check_target(target, (TABLE, LAYER, PAGE), ("state", "object_id"), "states of a register", [labelled])
        named = RegisterFile(Path(places[0]), _pairs(column, "--column"), _pairs(value, "--value"), kind, layer, crs)
        with collected_warnings(verbose=verbose) as logged:
            compared = compare_register(named, labelled, Delivery(Path(folder)).corrected)
            written = write_compared(compared, target, register=Path(places[0]), warnings=list(logged))
        print_compared(output_console(), compared)
        print_warnings(output_console(), logged)
        for path in written:
            output_console().print(f"  {shown_path(path)}", markup=False)


def _pairs(given: list[str] | None, option: str) -> dict[str, str]:
    pairs = [item.partition("=") for item in given or ()]
    wrong = next((name for name, sign, text in pairs if not (name and sign and text)), None)
    if wrong is not None:
        raise typer.BadParameter(f"{wrong!r} must have the form NAME=VALUE", param_hint=option)
    return {name: text for name, _, text in pairs}


def print_compared(console: Any, compared: "ComparedRegister") -> None:
    """Print the number of entries by kind and state, and the offset of the register."""
    from mlsroad_pipeline.algorithms.inventory.register.states import STATES
    from mlsroad_pipeline.label.register import offset_text

    table = compared.table
    rows = [
        (str(name), *(f"{(part['state'] == state).sum():,}" for state in STATES))
        for name, part in table.groupby("kind", sort=True)
    ]
    console.print(count_table(rows, ("kind", *STATES)))
    console.print(f"\n{offset_text(compared.offset)}")

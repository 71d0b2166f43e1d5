"""Command `mlsroad simulate`: a simulated survey with known labels."""

from pathlib import Path
from shlex import quote
from typing import Annotated, Any

import typer

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.commands.console import (
    error_console,
    one_line_errors,
    output_console,
    shown_path,
    survey_progress,
)
from mlsroad_pipeline.commands.options import Verbose, expanded, nested


def _presets() -> list[str]:
    from mlsroad_pipeline.surveys.simulated import presets

    return list(presets())


def simulate(
    output: Annotated[str, typer.Option("--output", "-o", metavar="FOLDER", help="Folder of the survey.")] = "street",
    preset: Annotated[
        str, typer.Option(help="Scanner and street, such as vmx450, hdl64, pandar64, oakland.", autocompletion=_presets)
    ] = "small",
    seed: Annotated[int, typer.Option(help="Seed of the street.")] = 1,
    length: Annotated[float | None, typer.Option(metavar="METRES", help="Length of the street.")] = None,
    params: Annotated[
        list[str] | None, typer.Option("--params", metavar="KEY=VALUE", help="Change a parameter of the simulation.")
    ] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace the folder.")] = False,
    verbose: Verbose = False,
) -> None:
    """Simulate the survey of a street: points with labels, trajectory, images and a list of objects."""
    config: dict[str, Any] = {"preset": preset, "seed": seed, **({} if length is None else {"length": length})}
    with one_line_errors(verbose=verbose):
        folder = Path(expanded([output])[0])
        write_street({**config, **nested(params or [])}, folder, overwrite=overwrite)


def write_street(config: dict[str, Any], folder: Path, *, overwrite: bool) -> None:
    """Simulate a survey into a folder, with a progress bar, and print what is there."""
    from mlsroad_pipeline.surveys.simulated import configured_survey, write_simulated_survey

    parameters, layout = configured_survey(config)
    if folder.exists() and not folder.is_dir():
        raise ParameterError(f"{folder} is a file: name another folder with --output")
    if folder.is_dir() and any(folder.iterdir()) and not overwrite:
        raise ParameterError(f"{folder} is not empty: name another with --output, or replace it with --overwrite")
    with survey_progress(error_console(), parameters.length * parameters.passes) as progress:
        written = write_simulated_survey(
            parameters=parameters, folder=str(folder), n_threads=2, files=layout, progress=progress
        )
    files = layout.names(parameters)
    console = output_console()
    console.print(f"Simulated {parameters.length:g} m of street: {int(written['n_points']):,} points.\n")
    console.print(f"  points   {shown_path(folder / files[0])}" + (f" and {len(files) - 1} more" if files[1:] else ""))
    console.print(f"  objects  {shown_path(folder / 'objects.csv')}")
    console.print(f"\nLabel it: mlsroad label {quote(shown_path(folder))}")

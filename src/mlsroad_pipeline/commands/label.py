"""Command `mlsroad label`: a labelled survey, an inventory and a report."""

import os
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from shlex import quote
from typing import Annotated, Any

import typer
from rich.console import Console

from mlsroad_pipeline import kernels_in_temporary_folder
from mlsroad_pipeline.algorithms.models.methods import METHODS
from mlsroad_pipeline.commands.console import (
    Compiling,
    Stages,
    collected_warnings,
    count_table,
    error_console,
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
    Workers,
    check_exist,
    default_output,
    expanded,
    literal,
    nested,
    survey_of,
)
from mlsroad_pipeline.commands.session import KERNELS_OF_LABEL, compiled_kernels, configure, find_place, run_pipeline
from mlsroad_pipeline.execution.parameter_checks import merged

STAGES = {
    "files": ("Reading headers", 0.04),
    "corridors": ("Finding the trajectory", 0.04),
    "pieces": ("Cutting into scenes", 0.32),
    "results": ("Labelling", 0.42),
    "objects": ("Joining the objects", 0.02),
    "written": ("Writing", 0.16),
}
"""Stage to its description and its share of the time on two cores, from a survey of 5 million points."""

Crs = Annotated[str | None, typer.Option(metavar="EPSG:...", help="Coordinate system of the survey.")]
Export = Annotated[
    list[str] | None,
    typer.Option(
        "--export",
        metavar="FORMAT",
        help="Also write the inventory as csv, geojson, flatgeobuf, shapefile, gml or dxf; may be repeated, or a list "
        "separated by commas.",
    ),
]
KeepClasses = Annotated[bool, typer.Option("--keep-classes", help="Keep the classes of the input; label the others.")]
ClassMap = Annotated[
    str | None,
    typer.Option("--class-map", metavar="MAP", help="Meaning of these classes: asprs, semantickitti, ..., or a file."),
]
Overwrite = Annotated[
    bool, typer.Option("--overwrite", help="Replace results of another survey or other settings, and edited ones.")
]

GIVEN_LABELS = "given_labels"
"""Method that takes the given classes alone."""

REPEATED = "repeat_label_summary"
"""Node that runs in place of all others where the results of the same run are there and unchanged."""


def label(  # typer reads the options from the signature
    files: Surveys,
    output: Output = None,
    method: Annotated[
        str | None,
        typer.Option(
            help="Method of a registered model, such as patch_graph_mrf.", autocompletion=lambda: list(METHODS)
        ),
    ] = None,
    model: Annotated[
        str | None, typer.Option(help="Shipped model by name, or version or alias of a registered one.")
    ] = None,
    crs: Crs = None,
    copc: Annotated[bool, typer.Option("--copc", help="Also write a cloud-optimised copy (.copc.laz).")] = False,
    export: Export = None,
    photos: Annotated[
        bool, typer.Option("--photos", help="Also write a photo of each object that images beside the points show.")
    ] = False,
    within: Annotated[
        float | None, typer.Option(metavar="METRES", help="Leave out objects and lines farther from the path.")
    ] = None,
    keep_classes: KeepClasses = False,
    keep: Annotated[
        str | None,
        typer.Option(
            "--keep", metavar="CODES", help="Keep these class numbers alone, such as 2,6,7; also beside --keep-classes."
        ),
    ] = None,
    class_map: ClassMap = None,
    labels: Annotated[
        str | None, typer.Option("--labels", metavar="FOLDER", help="Take predictions in files with the clouds' names.")
    ] = None,
    labels_map: Annotated[
        str | None, typer.Option("--labels-map", metavar="MAP", help="Class map of these predictions.")
    ] = None,
    overwrite: Overwrite = False,
    params: Params = None,
    workers: Workers = None,
    verbose: Verbose = False,
) -> None:
    """Label point clouds, and map their poles, signs, vehicles and trees.

    Writes every point with a classification and a confidence as LAZ, the objects as GeoPackage and GeoParquet, and a
    report. A killed run continues with the same command.
    """
    options: dict[str, Any] = {"method": method, "model": model, "crs": crs, "copc": copc or None}
    options |= {"export": export or None, "photos": photos or None, "overwrite": overwrite or None, "within": within}
    folder = None if labels is None else literal(expanded([labels])[0])
    kept = keep_classes or keep is not None
    given = {"keep_classes": kept or None, "keep": keep, "labels": folder, "labels_classes": labels_map}
    options["given"] = given | {"classes": class_map}
    label_files(files, output, options, params=params, workers=workers, verbose=verbose)


def inventory(
    files: Surveys,
    output: Output = None,
    class_map: ClassMap = None,
    crs: Crs = None,
    export: Export = None,
    overwrite: Overwrite = False,
    params: Params = None,
    workers: Workers = None,
    verbose: Verbose = False,
) -> None:
    """Map the poles, signs, vehicles, trees and lines of point clouds that are classified already.

    Writes what `label` writes. No model labels: points without a class stay without one.
    """
    options: dict[str, Any] = {"method": GIVEN_LABELS, "crs": crs, "export": export or None}
    options |= {"overwrite": overwrite or None, "given": {"keep_classes": True, "classes": class_map}}
    label_files(files, output, options, params=params, workers=workers, verbose=verbose)


def label_files(
    files: Sequence[str],
    output: str | None,
    options: Mapping[str, Any],
    *,
    params: Sequence[str] | None,
    workers: int | None,
    verbose: bool,
) -> None:
    """Run `label` with parameters, of which those that are None have their defaults, and print the summary."""
    begin = time.perf_counter()
    chosen = {name: value for name, value in options.items() if value is not None}
    chosen["given"] = {name: value for name, value in options["given"].items() if value is not None}
    changed = nested(params or [], given={"label.survey": "FILE", "label.output": "--output"})
    with one_line_errors(verbose=verbose):
        places = expanded(files)
        check_exist(places)
        folder = default_output(places) if output is None else Path(expanded([output])[0])
        parameters: dict[str, Any] = {"label": {"survey": survey_of(places), "output": literal(str(folder)), **chosen}}
        if workers is not None:
            parameters["execution"] = {"n_workers": workers}
        parameters = merged(parameters, changed)
        place = find_place()
        is_first = not compiled_kernels()  # before the workers start, which compile
        configure(place)
        if is_first:
            error_console().print("First run: the kernels are compiled once, which takes one to two minutes.")
            if kernels_in_temporary_folder:
                kept = f"Neither package nor cache can be written: kernels are kept in {os.environ['NUMBA_CACHE_DIR']}."
                error_console().print(kept, markup=False)
        compiling = Compiling(compiled_kernels, KERNELS_OF_LABEL, until="Labelling") if is_first else None
        stages = Stages(STAGES, error_console(), compiling=compiling)
        with collected_warnings(verbose=verbose) as logged, stages.shown():
            run = run_pipeline("label", parameters, place=place)
            summary = run.catalog.load("label_summary")
        seconds = None if REPEATED in run.nodes else time.perf_counter() - begin
        print_summary(output_console(), summary, logged, seconds=seconds)


def print_summary(console: Console, summary: Mapping[str, Any], logged: list[str], *, seconds: float | None) -> None:
    """Print counts per class and kind of object, warnings and paths; without seconds, the run was finished before."""
    confidence, n_points = summary["confidence"], summary["n_points"]
    files = "1 file" if summary["n_files"] == 1 else f"{summary['n_files']} files"
    median = "" if confidence["median"] is None else f", median confidence {confidence['median']:.2f}"
    begin = "Already labelled:" if seconds is None else "Labelled"
    duration = "" if seconds is None else f" in {seconds:.1f} s"
    console.print(f"{begin} {n_points:,} points of {files}{duration} with {_model(summary)}{median}.\n")
    if summary.get("kept"):
        console.print(f"{summary['kept']:,} points keep their class.\n")
    rows = [
        (name, f"{count:,}", f"{100 * count / max(n_points, 1):.1f} %", _median(confidence["class_medians"], name))
        for name, count in sorted(summary["classes"].items(), key=lambda item: -item[1])
    ]
    console.print(count_table(rows, ("class", "points", "share", "confidence")))
    objects = [(kind, f"{count:,}") for kind, count in summary["objects"].items()]
    objects += [(kind, f"{length:,.0f} m") for kind, length in summary.get("lines", {}).items()]
    console.print()
    if objects:
        console.print(count_table(objects, ("object", "count")))
    else:
        console.print("No poles, signs, vehicles or trees were found.")
    print_warnings(console, [*summary["warnings"], *logged])
    _print_results(console, summary)


def _print_results(console: Console, summary: Mapping[str, Any]) -> None:
    """Print the paths of the results, and the command that opens them."""
    outputs = summary["outputs"]
    clouds, n_files = [shown_path(path) for path in outputs["clouds"]], summary["n_files"]
    console.print("\nResults")
    more = len(clouds) - n_files
    copies = f" and {more} {'copy' if more == 1 else 'copies'} in other formats" if more > 0 else ""
    named = f"{n_files} {'file' if n_files == 1 else 'files'}{copies}, the first is {clouds[0]}"
    console.print(f"  points     {clouds[0] if len(clouds) == 1 else named}")
    console.print(f"  inventory  {shown_path(outputs['inventory'])}")
    for path in _main_exports(outputs["exports"], summary["output"]):
        console.print(f"  export     {shown_path(path)}")
    console.print(f"  report     {shown_path(outputs['report'])}")
    console.print(f"\nOpen it in the browser: mlsroad open {quote(shown_path(summary['output']))}")


def _main_exports(paths: Sequence[str], output: str) -> list[str]:
    """Return the exported files without those that only describe others, and folders in place of their files."""
    found = [Path(path) for path in paths if Path(path).suffix not in (".csvt", ".prj")]
    return list(dict.fromkeys(str(path if path.parent == Path(output) else path.parent) for path in found))


def _model(summary: Mapping[str, Any]) -> str:
    """Return the name and the method of the model, with the version of a registered one."""
    model = summary["model"]
    if summary["method"] == GIVEN_LABELS:
        return "the given classes"
    if not isinstance(model, Mapping):
        return f"a model of {summary['method']}"
    version = f" version {model['version']}" if "run_id" in model else ""
    return f"the model {model['name']}{version} ({summary['method']})"


def _median(medians: Mapping[str, float], name: str) -> str:
    return f"{medians[name]:.2f}" if name in medians else ""

"""Command `mlsroad learn`: a model that has learned from the corrections of labelled surveys."""

from __future__ import annotations

import os
import time
from collections.abc import Mapping
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.commands.console import (
    Stages,
    collected_warnings,
    count_table,
    error_console,
    one_line_errors,
    output_console,
)
from mlsroad_pipeline.commands.label import STAGES, print_summary
from mlsroad_pipeline.commands.options import Verbose, Workers, check_exist, expanded, literal, results_folder
from mlsroad_pipeline.commands.session import STORE, Place, configure, find_place, model_store, run_pipeline
from mlsroad_pipeline.execution.output_lock import lock_output, release_output

if TYPE_CHECKING:
    from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
    from mlsroad_pipeline.review.corrections.comparison import Comparison
    from mlsroad_pipeline.review.corrections.labelled_output import LabelledOutput


def learn(
    outputs: Annotated[
        list[str], typer.Argument(metavar="OUT...", help="Folders of results of label, corrected, or their surveys.")
    ],
    label: Annotated[
        bool, typer.Option("--label/--no-label", help="Label the surveys again with the new model.")
    ] = True,
    accept: Annotated[
        bool, typer.Option("--accept", help="Take the new model also where the comparison finds it worse.")
    ] = False,
    undo: Annotated[
        bool, typer.Option("--undo", help="Put the results of before the last learning back; again for the one before.")
    ] = False,
    workers: Workers = None,
    verbose: Verbose = False,
) -> None:
    """Learn from the corrections of labelled surveys, and label them again.

    The model that labelled the surveys continues its training. The new model is registered in MLflow,
    or written into the first folder where no store is configured. A model that is worse on answers that
    were held out, or that loses a class elsewhere, is not taken.
    """
    with one_line_errors(verbose=verbose):
        places = [results_folder(place) for place in expanded(outputs)]
        check_exist(places)
        if undo:
            _undo(places)
        else:
            _learn(places, label=label, accept=accept, workers=workers, verbose=verbose)


def _learn(places: list[str], *, label: bool, accept: bool, workers: int | None, verbose: bool) -> None:
    """Learn, and label the surveys again; their results are kept before."""
    from mlsroad_pipeline.review.corrections.kept_results import keep_results
    from mlsroad_pipeline.review.corrections.labelled_output import LabelledOutput

    place, console = find_place(), output_console()
    configure(place)
    found = [LabelledOutput.at(folder) for folder in places]
    for output in found:
        lock_output(output.path)
        output.check_unedited()
    chosen, verdict = _learn_and_store(found, place, accept=accept, verbose=verbose)
    for output in found:
        if label:
            keep_results(output)
        release_output(output.path)
    if label:
        error_console().print(
            "The new trees can change the label of every point: the whole of each survey is labelled again."
        )
        for output in found:
            _print_changes(output, _label_again(output, chosen, workers, place, verbose=verbose))
        undo = " ".join(quote(str(output.path)) for output in found)
        console.print(f"\nGo back: mlsroad learn --undo {undo}", markup=False)
    else:
        options = " ".join(f"--{key} {quote(str(value))}" for key, value in chosen.items())
        console.print(f"Use it: mlsroad label FILE {options}", markup=False)
    console.print(f"\nComparison: {verdict}.", markup=False)


def _undo(places: list[str]) -> None:
    """Put the results of before the last learning back; all folders are checked before the first is changed."""
    from mlsroad_pipeline.review.corrections.kept_results import kept_folders, kept_note, put_back

    folders = [Path(place) for place in places]
    for folder in folders:
        kept_note(folder)
        lock_output(folder)
    for folder in folders:
        put_back(folder)
        left = len(kept_folders(folder))
        output_console().print(
            f"{folder} has the results of before the learning again ({left} earlier learnings can be undone).",
            markup=False,
        )


def _learn_and_store(
    outputs: list[LabelledOutput], place: Place, *, accept: bool, verbose: bool
) -> tuple[dict[str, Any], str]:
    """Learn from outputs, compare, store the new model; return the options that use it, and the verdict."""
    from mlsroad_pipeline.review.corrections.comparison import WORSE, compare_learning
    from mlsroad_pipeline.review.corrections.learners import register_learned, write_learned
    from mlsroad_pipeline.review.corrections.learning import read_corrections, train_on

    bundle, parent = _one_model(outputs, place)
    console, errors = output_console(), error_console()
    with collected_warnings(verbose=verbose) as logged:
        data = read_corrections(bundle, outputs, progress=lambda name: errors.print(f"Reading {name}", markup=False))
        model, n_answers = train_on(bundle, data, parent=parent, surveys=[output.path.name for output in outputs])
        errors.print("Comparing: answers are held out by turn")
        comparison = compare_learning(bundle, model, data)
        _print_comparison(comparison)
        verdict, reason = comparison.verdict()
        if verdict == WORSE and not accept:
            raise DataError(f"the new model is worse and is not taken (--accept takes it): {reason}")
        if place.tracked:
            store = os.environ.get("MLFLOW_TRACKING_URI") or f"sqlite:///{place.folder / STORE}"
            name, chosen = register_learned(model, parent, store)
        else:
            name, chosen = write_learned(model, outputs[0].path)
    console.print(f"Learned from {n_answers} answers. New model: {name}", markup=False)
    for line in logged:
        console.print(f"Warning: {line}", markup=False)
    return chosen, f"{verdict}, because {reason}"


def _print_comparison(comparison: Comparison) -> None:
    """Print the right shares of held-out answers by class, and the sure voxels without an answer that change."""
    console = output_console()
    for table, name, what in ((comparison.answers, "class", "answers"), (comparison.objects, "kind", "objects")):
        grouped = table.groupby(name, sort=True)
        rows = [
            (str(group), str(len(own)), f"{own['before'].mean():.0%}", f"{own['after'].mean():.0%}")
            for group, own in grouped
        ]
        if rows:
            console.print(count_table(rows, (f"held-out {what}", "number", "right before", "after")))
    lost = [
        (str(row["class"]), f"{row['voxels']:,}", f"{row['changed']:,}", str(row["to"]))
        for row in comparison.rest.to_dict("records")
        if row["changed"]
    ]
    if lost:
        console.print(count_table(lost, ("sure voxels without an answer", "number", "changed", "most to")))


def _print_changes(output: LabelledOutput, summary: Mapping[str, Any]) -> None:
    """Print the objects, and the points by class, before and after."""
    from mlsroad_pipeline.review.corrections.kept_results import changed_points

    console, before = output_console(), output.record["summary"]
    counts = [{**found["objects"], **found.get("lines", {})} for found in (before, summary)]
    names = dict.fromkeys(name for found in counts for name in found)
    rows = [(name, *(f"{found.get(name, 0):,.0f}" for found in counts)) for name in names]
    console.print("\nChanged by the learning")
    console.print(count_table(rows, ("objects, metres of lines", "before", "after")))
    moved = [
        (str(row["class"]), *(f"{row[name]:,}" for name in ("before", "after", "changed")), str(row["to"]))
        for row in changed_points(output.path).to_dict("records")
    ]
    console.print(count_table(moved, ("points", "before", "after", "changed", "most to")))


def _one_model(outputs: list[LabelledOutput], place: Place) -> tuple[ModelBundle, dict[str, Any]]:
    """Return the model that labelled all outputs, and its name and version."""
    from mlsroad_pipeline.algorithms.core.classes import find_scheme
    from mlsroad_pipeline.algorithms.models.given_labels.labeller import SLUG as GIVEN_LABELS
    from mlsroad_pipeline.algorithms.models.given_labels.labeller import given_bundle
    from mlsroad_pipeline.label.given_classes import GIVEN_SCHEME
    from mlsroad_pipeline.label.model_choice import choose_model, load_choice
    from mlsroad_pipeline.review.corrections.learning import check_learnable

    for output in outputs:
        check_learnable(output)
    first = outputs[0]
    for other in outputs[1:]:
        if (other.model["name"], other.model["version"]) != (first.model["name"], first.model["version"]):
            raise ParameterError(
                f"{first.path} was labelled by {first.model['name']} {first.model['version']}, {other.path} by "
                f"{other.model['name']} {other.model['version']}: label both with one model, or learn one by one"
            )
    used, store = first.model, model_store(place)
    if first.method == GIVEN_LABELS:  # a method without weights
        scheme = find_scheme(first.schemes, GIVEN_SCHEME)
        return given_bundle(scheme, scheme.codes(first.written_scheme)), dict(used)
    registered = used.get("source") == "registered"
    method = first.method if registered else None
    wanted = used["version"] if registered else used.get("folder", used["name"])
    choice = choose_model(method=method, model=wanted, store=store)
    kept = {name: used[name] for name in ("name", "version", "source") if name in used}
    return load_choice(choice, store), kept


def _label_again(
    output: LabelledOutput, chosen: dict[str, Any], workers: int | None, place: Place, *, verbose: bool
) -> Mapping[str, Any]:
    """Label a survey again with the same settings and another model; return the summary."""
    settings = {name: _literal(value) for name, value in output.parameters().items()}
    parameters: dict[str, Any] = {"label": {**settings, **{key: literal(str(v)) for key, v in chosen.items()}}}
    parameters["label"]["output"] = literal(str(Path(output.path).absolute()))
    if workers is not None:
        parameters["execution"] = {"n_workers": workers}
    begin = time.perf_counter()
    with collected_warnings(verbose=verbose) as logged, Stages(STAGES, error_console()).shown():
        summary: Mapping[str, Any] = run_pipeline("label", parameters, place=place).catalog.load("label_summary")
    print_summary(output_console(), summary, logged, seconds=time.perf_counter() - begin)
    return summary


def _literal(value: Any) -> Any:
    if isinstance(value, str):
        return literal(value)
    return [_literal(item) for item in value] if isinstance(value, list) else value

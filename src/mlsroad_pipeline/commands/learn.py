"""Command `mlsroad learn`: a model that has learned from the corrections of labelled surveys."""

from __future__ import annotations

import os
import time
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.commands.console import (
    Stages,
    collected_warnings,
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
    from mlsroad_pipeline.review.corrections.labelled_output import LabelledOutput


def learn(
    outputs: Annotated[
        list[str], typer.Argument(metavar="OUT...", help="Folders of results of label, corrected, or their surveys.")
    ],
    label: Annotated[
        bool, typer.Option("--label/--no-label", help="Label the surveys again with the new model.")
    ] = True,
    workers: Workers = None,
    verbose: Verbose = False,
) -> None:
    """Learn from the corrections of labelled surveys, and label them again.

    The model that labelled the surveys continues its training. The new model is registered in MLflow,
    or written into the first folder where no store is configured.
    """
    from mlsroad_pipeline.review.corrections.labelled_output import LabelledOutput

    with one_line_errors(verbose=verbose):
        places = [results_folder(place) for place in expanded(outputs)]
        check_exist(places)
        place = find_place()
        configure(place)
        found = [LabelledOutput.at(folder) for folder in places]
        for output in found:
            lock_output(output.path)
            output.check_unedited()
        chosen = _learn_and_store(found, place, verbose=verbose)
        for output in found:
            release_output(output.path)
        if label:
            error_console().print(
                "The new trees can change the label of every point: the whole of each survey is labelled again."
            )
            for output in found:
                _label_again(output, chosen, workers, place, verbose=verbose)
        else:
            options = " ".join(f"--{key} {quote(str(value))}" for key, value in chosen.items())
            output_console().print(f"Use it: mlsroad label FILE {options}", markup=False)


def _learn_and_store(outputs: list[LabelledOutput], place: Place, *, verbose: bool) -> dict[str, Any]:
    """Learn from outputs, store the new model, print its name and the warnings; return the options that use it."""
    from mlsroad_pipeline.review.corrections.learners import register_learned, write_learned
    from mlsroad_pipeline.review.corrections.learning import learn_from

    bundle, parent = _one_model(outputs, place)
    console, errors = output_console(), error_console()
    with collected_warnings(verbose=verbose) as logged:
        model, n_answers = learn_from(
            bundle, outputs, parent=parent, progress=lambda name: errors.print(f"Reading {name}", markup=False)
        )
        if place.tracked:
            store = os.environ.get("MLFLOW_TRACKING_URI") or f"sqlite:///{place.folder / STORE}"
            name, chosen = register_learned(model, parent, store)
        else:
            name, chosen = write_learned(model, outputs[0].path)
    console.print(f"Learned from {n_answers} answers. New model: {name}", markup=False)
    for line in logged:
        console.print(f"Warning: {line}", markup=False)
    return chosen


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
) -> None:
    """Label a survey again with the same settings and another model."""

    settings = {name: _literal(value) for name, value in output.parameters().items()}
    parameters: dict[str, Any] = {"label": {**settings, **{key: literal(str(v)) for key, v in chosen.items()}}}
    parameters["label"]["output"] = literal(str(Path(output.path).absolute()))
    if workers is not None:
        parameters["execution"] = {"n_workers": workers}
    begin = time.perf_counter()
    with collected_warnings(verbose=verbose) as logged, Stages(STAGES, error_console()).shown():
        summary = run_pipeline("label", parameters, place=place).catalog.load("label_summary")
    print_summary(output_console(), summary, logged, seconds=time.perf_counter() - begin)


def _literal(value: Any) -> Any:
    if isinstance(value, str):
        return literal(value)
    return [_literal(item) for item in value] if isinstance(value, list) else value

"""Command `mlsroad models`: the models that `label` can use, and the one that it takes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer

from mlsroad_pipeline.commands.console import collected_warnings, one_line_errors, output_console, print_warnings
from mlsroad_pipeline.commands.options import Verbose
from mlsroad_pipeline.commands.session import find_place, model_store

if TYPE_CHECKING:
    from mlsroad_pipeline.label.model_choice import AvailableModel


def models(
    method: Annotated[str | None, typer.Option(help="Method, as for label.")] = None,
    model: Annotated[str | None, typer.Option(help="Model, as for label.")] = None,
    verbose: Verbose = False,
) -> None:
    """List the models: trained on what, scores, licence; then the one that label takes, and why."""
    from mlsroad_pipeline.label.model_choice import available_models, choose_model

    console = output_console()
    with one_line_errors(verbose=verbose):
        store = model_store(find_place())
        with collected_warnings(verbose=verbose) as logged:
            available = available_models(store)
            choice = choose_model(method=method, model=model, store=store)
        for item in available:
            print_model(console, item)
        print_warnings(console, logged)
        console.print(f"\nlabel takes {choice.name}: {choice.reason}.")


def print_model(console: Any, item: AvailableModel) -> None:
    """Print a model: a line with its name, then indented lines on its training and scores."""
    aliases = f" ({', '.join(item.aliases)})" if item.aliases else ""
    source = "shipped" if item.shipped else "registered"
    version = "" if item.shipped else f" version {item.version}"
    console.print(f"{item.name}{version}{aliases}: {item.method}, {source}")
    console.print(f"  trained on  {item.trained_on or 'unknown data'}")
    entry = item.entry
    if entry is None:
        return
    console.print(f"  for         {entry.summary}")
    console.print(f"  classes     {', '.join(entry.classes)}")
    for score in entry.scores:
        console.print(
            f"  scores      {score.data}: overall accuracy {score.overall_accuracy:.3f}, mean F1 {score.mean_f1:.3f}"
        )
    size = sum(int(file["bytes"]) for file in entry.files.values()) / 1e6
    console.print(f"  licence     {entry.licence}, {size:.1f} MB")

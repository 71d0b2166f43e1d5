"""Command `mlsroad models`: the models that `label` can use, and the one that it takes."""

from __future__ import annotations

from typing import Annotated

import typer

from mlsroad_pipeline.commands.console import collected_warnings, one_line_errors, output_console, print_warnings
from mlsroad_pipeline.commands.options import Verbose
from mlsroad_pipeline.commands.session import find_place, model_store


def models(
    method: Annotated[str | None, typer.Option(help="Method, as for label.")] = None,
    model: Annotated[str | None, typer.Option(help="Model, as for label.")] = None,
    verbose: Verbose = False,
) -> None:
    """List the models: trained on what, scores, licence; then the one that label takes, and why."""
    from mlsroad_pipeline.label.model_choice import available_models, choose_model, model_lines

    console = output_console()
    with one_line_errors(verbose=verbose):
        store = model_store(find_place())
        with collected_warnings(verbose=verbose) as logged:
            available = available_models(store)
            choice = choose_model(method=method, model=model, store=store)
        for item in available:
            console.print("\n".join(model_lines(item)))
        print_warnings(console, logged)
        console.print(f"\nlabel takes {choice.name}: {choice.reason}.")

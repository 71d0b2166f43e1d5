"""The command `mlsroad`."""

import codecs
import io
import os
import signal
import sys
import unicodedata
from pathlib import Path
from typing import Annotated, Any

import typer

from mlsroad_pipeline import __version__
from mlsroad_pipeline.commands.compare import compare
from mlsroad_pipeline.commands.corrections import corrections
from mlsroad_pipeline.commands.export import export
from mlsroad_pipeline.commands.inspect import inspect
from mlsroad_pipeline.commands.label import inventory, label
from mlsroad_pipeline.commands.learn import learn
from mlsroad_pipeline.commands.models import models
from mlsroad_pipeline.commands.open_results import open_results
from mlsroad_pipeline.commands.road import road
from mlsroad_pipeline.commands.score import score
from mlsroad_pipeline.commands.simulate import simulate
from mlsroad_pipeline.commands.warm_up import warm_up

app = typer.Typer(
    name="mlsroad",
    help="Label mobile laser scanning surveys of roads and map their objects.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["--help", "-h"]},
)
for command in (label, inventory, road, learn, export, inspect, simulate, models, score, compare):
    app.command()(command)
app.command("open")(open_results)
app.command("warm-up")(warm_up)
app.add_typer(corrections, name="corrections")


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"mlsroad {__version__}")
        raise typer.Exit


@app.callback()
def options(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """Options of `mlsroad` itself; typer takes the help from the application."""


def write_any_character(stream: Any) -> None:
    """Let a stream of few characters, such as that of an ASCII terminal, write the others as like ones: m2 for m²."""
    codecs.register_error("like", _like)
    if isinstance(stream, io.TextIOWrapper) and stream.errors == "strict":
        stream.reconfigure(errors="like")


def _like(error: UnicodeError) -> tuple[str, int]:
    """Return the plain characters that unencodable ones are made of, question marks for those without."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    text = error.object[error.start : error.end]
    parts = [unicodedata.normalize("NFKD", letter).encode("ascii", "ignore").decode() or "?" for letter in text]
    return "".join(parts), error.end


def main() -> None:
    """Run the command line; SIGTERM ends it like Ctrl-C."""
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:  # closed; libraries flush both
            setattr(sys, name, Path(os.devnull).open("w", encoding="utf-8"))  # noqa: SIM115  # until the end
        write_any_character(getattr(sys, name))
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    app()

"""Folders of comparisons: what must not be replaced in them."""

from collections.abc import Collection
from pathlib import Path

import pandas as pd

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.review.corrections.labelled_output import LabelledOutput


def check_target(
    folder: Path, names: Collection[str], columns: Collection[str], what: str, outputs: Collection[LabelledOutput]
) -> None:
    """Raise ParameterError where results of a comparison would lie among files of the user.

    `names` are the files of the results: first a table, which has `columns`; `what` they hold.
    """
    check_folder(folder)
    place = folder.resolve()
    for output in outputs:
        inputs = {Path(entry["path"]).resolve().parent for entry in output.record.get("inputs", ())}
        if place in {output.path.resolve(), *inputs}:
            raise ParameterError(f"--output {folder} is a folder of the survey itself: name another folder")
    there = [name for name in names if (folder / name).exists()]
    if there and not _has_columns(folder / next(iter(names)), columns):
        raise ParameterError(f"{folder / there[0]} does not hold {what}: name another folder with --output, or move it")


def check_folder(folder: Path) -> None:
    """Raise ParameterError for an output folder that is a file, or would lie below one."""
    there = next(place for place in (folder, *folder.absolute().parents) if place.exists())
    if not there.is_dir():
        raise ParameterError(f"{there} is a file: name a folder with --output")


def _has_columns(table: Path, columns: Collection[str]) -> bool:
    try:
        return set(columns) <= set(pd.read_csv(table, nrows=0))
    except (OSError, ValueError):  # none, or not a table
        return False

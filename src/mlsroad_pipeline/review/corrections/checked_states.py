"""Tables of `mlsroad compare` and `mlsroad road` with what users decided about the states of their entries."""

from collections.abc import Collection, Sequence
from pathlib import Path

import pandas as pd

from mlsroad_pipeline.inventory_files.vector_files import without_formulas
from mlsroad_pipeline.review.compared_entries import (
    COMPARED,
    Entry,
    checked_of,
    compared_entries,
    entries_of,
    is_about,
)
from mlsroad_pipeline.review.corrections.decisions import Decision
from mlsroad_pipeline.review.corrections.store import open_corrections


def with_checked(table: pd.DataFrame, name: str, folder: Path) -> pd.DataFrame:
    """Return a compared table that is about to be written with the column `checked`: right, wrong or empty."""
    with open_corrections(folder, write=False, create=False) as store:
        decisions = store.states().checks
    content = without_formulas(table).to_csv(index=False, lineterminator="\n").encode()
    entries = entries_of(content, name, folder / COMPARED[name].file)
    return _with_column(table, name, entries, decisions)


def _with_column(table: pd.DataFrame, name: str, entries: list[Entry], decisions: Sequence[Decision]) -> pd.DataFrame:
    checked = checked_of(name, entries, decisions)
    return table.assign(checked=[checked.get(entry.name, "") for entry in entries])


def checked_tables(
    folder: Path, decisions: Sequence[Decision], names: Collection[str] = tuple(COMPARED)
) -> tuple[dict[str, pd.DataFrame], list[str]]:
    """Return the compared tables in a folder of results, as texts with `checked`, and why others are left out."""
    found, left_out = compared_entries(folder, names)
    tables = {name: pd.read_csv(folder / COMPARED[name].file, dtype=str, keep_default_na=False) for name in found}
    return {name: _with_column(tables[name], name, found[name], decisions) for name in found}, left_out


def lost_checks(decisions: Sequence[Decision], folder: Path) -> list[Decision]:
    """Return the decisions about states that no compared table has any more."""
    present = {
        (table, entry.name, entry.state): entry
        for table, entries in compared_entries(folder)[0].items()
        for entry in entries
    }
    found = []
    for decision in decisions:
        given = decision.correction.payload
        entry = present.get((given["table"], given["entry"], given["state"]))
        if entry is None or not is_about(given, decision.correction.kind, entry):
            found.append(decision)
    return found


def counts_of_checks(table: pd.DataFrame) -> pd.DataFrame:
    """Return the numbers of right, wrong and unchecked entries of each kind and state."""
    names = {"right": "right", "wrong": "wrong", "": "left"}
    counts = table.groupby(["kind", "state", "checked"], sort=True).size().unstack(fill_value=0)
    counts = counts.reindex(columns=list(names), fill_value=0).rename(columns=names)
    return counts.rename_axis(columns=None).reset_index()

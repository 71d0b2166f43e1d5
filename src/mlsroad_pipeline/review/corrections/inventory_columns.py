"""Columns `status` and `checked_class` of the inventory, from the decisions in its output folder."""

import logging
from pathlib import Path

import pandas as pd

from mlsroad_pipeline.inventory_files.road_inventory import ATTRIBUTE, note_columns
from mlsroad_pipeline.review.corrections.listed_objects import ListedObjects
from mlsroad_pipeline.review.corrections.states import Note, States, fold_states
from mlsroad_pipeline.review.corrections.store import has_corrections, open_corrections

logger = logging.getLogger(__name__)


def corrected_table(table: pd.DataFrame, folder: Path) -> pd.DataFrame:
    """Return an inventory with the states of its objects; warn of decisions that match none of them."""
    if not has_corrections(folder):
        return table
    with open_corrections(folder, write=False) as store:
        decisions = store.current()
    states = fold_states(decisions, ListedObjects.of(table))
    if decisions:
        logger.info("%s of %s corrections were transferred", len(decisions) - len(states.unmatched), len(decisions))
    if states.unmatched:
        logger.warning(
            "%d of %d corrections match no object of this inventory and are kept: mlsroad corrections list %s",
            len(states.unmatched),
            len(decisions),
            folder,
        )
    return with_states(table, states)


def note_cells(note: Note | None) -> dict[str, str]:
    """Return note and attributes of an object by column of the inventory."""
    return {} if note is None else {"note": note.text, **{f"{ATTRIBUTE}{n}": v for n, v in note.attributes.items()}}


def with_states(table: pd.DataFrame, states: States) -> pd.DataFrame:
    """Return an inventory with the columns `status` and `checked_class` of the states of its objects.

    Where there are notes or attributes, it has `note` and a column per attribute too.
    """
    found = [states.of_objects.get(int(number), {}) for number in table["object_id"]]
    noted = [states.notes.get(int(number)) for number in table["object_id"]]
    typed = [*noted, *states.notes_of_added.values()]
    names = sorted({name for note in typed if note for name in note.attributes})
    columns = ["note", *(f"{ATTRIBUTE}{name}" for name in names)] if names or any(n and n.text for n in typed) else []
    blank = dict.fromkeys(columns, "")
    texts = pd.DataFrame([blank | note_cells(note) for note in noted], columns=columns, index=table.index)
    return table.drop(columns=note_columns(table)).assign(
        **{name: texts[name].astype("str") for name in columns},
        status=pd.array([state.get("status", "") for state in found], dtype="str"),
        checked_class=pd.array([state.get("checked_class", "") for state in found], dtype="str"),
    )

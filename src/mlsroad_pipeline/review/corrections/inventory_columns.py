"""Columns `status` and `checked_class` of the inventory, from the decisions in its output folder."""

import logging
from pathlib import Path

import pandas as pd

from mlsroad_pipeline.review.corrections.listed_objects import ListedObjects
from mlsroad_pipeline.review.corrections.states import States, fold_states
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


def with_states(table: pd.DataFrame, states: States) -> pd.DataFrame:
    """Return an inventory with the columns `status` and `checked_class` of the states of its objects."""
    found = [states.of_objects.get(int(number), {}) for number in table["object_id"]]
    return table.assign(
        status=pd.array([state.get("status", "") for state in found], dtype="str"),
        checked_class=pd.array([state.get("checked_class", "") for state in found], dtype="str"),
    )

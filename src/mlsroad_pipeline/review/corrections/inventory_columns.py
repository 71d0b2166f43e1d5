"""Columns `status` and `checked_class` of the inventory, from the decisions in its output folder."""

import logging
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from mlsroad_pipeline.algorithms.inventory.objects.table import OBJECT_FIELDS
from mlsroad_pipeline.inventory_files.geopackage import read_geopackage, write_geopackage
from mlsroad_pipeline.inventory_files.road_inventory import RoadInventory
from mlsroad_pipeline.review.corrections.listed_objects import ListedObjects
from mlsroad_pipeline.review.corrections.states import States, fold_states
from mlsroad_pipeline.review.corrections.store import has_corrections, open_corrections

logger = logging.getLogger(__name__)


def corrected_table(table: pd.DataFrame, folder: Path) -> pd.DataFrame:
    """Return an inventory with the states of its objects; warn of decisions that match none of them."""
    if not has_corrections(folder):
        return table
    with open_corrections(folder) as store:
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


def write_corrected(source: Path, target: Path, states: States, *, keep_rejected: bool) -> tuple[int, int]:
    """Write a corrected GeoPackage; return its number of objects, and that of the inventory."""
    inventory = read_geopackage(source)
    corrected = corrected_inventory(inventory, states, keep_rejected=keep_rejected)
    write_geopackage(corrected, target)
    return len(corrected.objects), len(inventory.objects)


def corrected_inventory(inventory: RoadInventory, states: States, *, keep_rejected: bool) -> RoadInventory:
    """Return an inventory with the base points, classes and states that users gave, and the objects that they added.

    Rejected objects, and those that were merged into others, are left out unless `keep_rejected` is set.
    """
    table = with_states(inventory.objects, states)
    for number, state in states.of_objects.items():
        if "x" in state:
            table.loc[table["object_id"] == number, ["x", "y", "z"]] = [state["x"], state["y"], state["z"]]
        if state["status"] != "rejected":
            given = [state["checked_class"], state["checked_kind"]]
            table.loc[table["object_id"] == number, ["class", "kind"]] = given
    if not keep_rejected:
        gone = [n for n, state in states.of_objects.items() if state["status"] == "rejected" or "merged_into" in state]
        table = table[~table["object_id"].isin(gone)]
        table = table.assign(pole_id=table["pole_id"].where(~table["pole_id"].isin(gone), 0))
    return replace(inventory, objects=pd.concat([table, _added_rows(states, inventory.objects)], ignore_index=True))


def _added_rows(states: States, objects: pd.DataFrame) -> pd.DataFrame:
    """Return the objects that users added, numbered after all others; their measures are unknown."""
    blank = {n: np.nan if kind == "float64" else 0 if kind == "int64" else "" for n, kind in OBJECT_FIELDS.items()}
    first = int(objects["object_id"].max() or 0) + 1 if len(objects) else 1
    rows = [
        {
            **blank,
            "object_id": first + k,
            "class": decision.correction.checked_class,
            "kind": decision.correction.kind,
            "status": "added",
            "checked_class": decision.correction.checked_class,
            **{axis: float(decision.correction.payload[axis]) for axis in "xyz"},
        }
        for k, decision in enumerate(states.added)
    ]
    return pd.DataFrame(rows, columns=list(OBJECT_FIELDS)).astype(OBJECT_FIELDS)

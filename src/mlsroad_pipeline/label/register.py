"""Comparison of a register with a labelled survey: its inventory, and what its scanner has seen."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.inventory.register.offset import Offset, register_offset
from mlsroad_pipeline.algorithms.inventory.register.states import confirm, decide, evidence_of
from mlsroad_pipeline.formats.files import write_atomic
from mlsroad_pipeline.inventory_files.geopackage import check_closed, read_geopackage, write_points
from mlsroad_pipeline.inventory_files.road_inventory import RoadInventory
from mlsroad_pipeline.inventory_files.vector_files import without_formulas
from mlsroad_pipeline.label.labelled_clouds import labelled_clouds, on_ground, seen_space
from mlsroad_pipeline.label.object_scoring import warn_of_distance
from mlsroad_pipeline.review.corrections.labelled_output import LabelledOutput
from mlsroad_pipeline.surveys.register_files import KINDS as REGISTERED
from mlsroad_pipeline.surveys.register_files import RegisterFile

INVENTORY = "inventory.gpkg"
"""Inventory of a survey; it has the path of the scanner too."""
TABLE, LAYER = "register.csv", "register.gpkg"
"""Files of a comparison."""


class ComparedRegister(NamedTuple):
    """States of all entries and of the objects without one, and the offset of the register."""

    table: pd.DataFrame
    offset: Offset
    crs: str | None


def compare_register(
    register: RegisterFile, output: LabelledOutput, inventory: RoadInventory | None = None
) -> ComparedRegister:
    """Return the states of the entries of a register in a labelled survey, by its inventory or a corrected one."""
    inventory = read_geopackage(output.path / INVENTORY) if inventory is None else inventory
    objects = inventory.objects[inventory.objects["kind"].isin(REGISTERED)].reset_index(drop=True)
    entries = register.read(inventory.crs).reset_index(drop=True)
    warn_of_distance(objects, entries, "entries of the register")
    offset = register_offset(*_places(entries), *_places(objects))
    moved = entries.assign(x=entries["x"] + offset.shift[0], y=entries["y"] + offset.shift[1])
    matches = confirm(moved, objects)
    clouds, rows = labelled_clouds(output, inventory), np.flatnonzero(matches.state == "")
    places = on_ground(moved[["x", "y"]].to_numpy(dtype=np.float64)[rows], clouds)
    rows, places = rows[np.isfinite(places[:, 2])], places[np.isfinite(places[:, 2])]
    kind = moved["kind"].to_numpy(dtype=str)[rows]
    seen = seen_space(places, kind, clouds)
    evidence = evidence_of(seen, kind, moved["height"].to_numpy(dtype=np.float64)[rows])
    table = decide(moved, objects, matches, rows, evidence, seen.rays)
    return ComparedRegister(table, offset, inventory.crs)


def _places(table: pd.DataFrame) -> tuple[NDArray[np.float64], NDArray[np.str_]]:
    return table[["x", "y"]].to_numpy(dtype=np.float64), table["kind"].to_numpy(dtype=str)


def write_compared(compared: ComparedRegister, folder: Path) -> list[Path]:
    """Write the states as a CSV table and a layer of a GeoPackage, each whole or not at all."""
    table = compared.table
    check_closed(folder / LAYER)
    write_atomic(folder / TABLE, without_formulas(table).to_csv(index=False, lineterminator="\n").encode())
    write_points(table, folder / LAYER, layer="register", crs=compared.crs)
    return [folder / TABLE, folder / LAYER]

"""Comparison of a register with a labelled survey: its inventory, and what its scanner has seen."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.inventory.register.offset import Offset, register_offset
from mlsroad_pipeline.algorithms.inventory.register.states import confirm, decide, evidence_of
from mlsroad_pipeline.formats.files import write_atomic
from mlsroad_pipeline.inventory_files.geopackage import check_closed, points_of, read_geopackage, write_shapes
from mlsroad_pipeline.inventory_files.road_inventory import RoadInventory
from mlsroad_pipeline.inventory_files.vector_files import without_formulas
from mlsroad_pipeline.label.change_report import map_of
from mlsroad_pipeline.label.labelled_clouds import Recorded, on_ground, seen_space
from mlsroad_pipeline.label.object_scoring import warn_of_distance
from mlsroad_pipeline.reporting.changes_page import changes_page
from mlsroad_pipeline.review.corrections.checked_states import with_checked
from mlsroad_pipeline.review.corrections.labelled_output import LabelledOutput
from mlsroad_pipeline.surveys.register_files import KINDS as REGISTERED
from mlsroad_pipeline.surveys.register_files import RegisterFile

INVENTORY = "inventory.gpkg"
"""Inventory of a survey; it has the path of the scanner too."""
TABLE, LAYER, PAGE = "register.csv", "register.gpkg", "register.html"
"""Files of a comparison."""
_HEADINGS = {
    "id": "Entry", "evidence": "Evidence", "object_id": "Object", "object_kind": "Kind of the object",
    "distance": "Distance [m]", "height_difference": "Height difference [m]", "x": "Easting [m]", "y": "Northing [m]",
    "checked": "Checked",
}  # fmt: skip


class ComparedRegister(NamedTuple):
    """States of all entries and of the objects without one, and the offset of the register."""

    table: pd.DataFrame
    offset: Offset
    survey: Recorded


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
    survey, rows = Recorded.of(output, inventory), np.flatnonzero(matches.state == "")
    clouds = survey.clouds
    places = on_ground(moved[["x", "y"]].to_numpy(dtype=np.float64)[rows], clouds)
    rows, places = rows[np.isfinite(places[:, 2])], places[np.isfinite(places[:, 2])]
    kind = moved["kind"].to_numpy(dtype=str)[rows]
    seen = seen_space(places, kind, clouds)
    evidence = evidence_of(seen, kind, moved["height"].to_numpy(dtype=np.float64)[rows])
    table = decide(moved, objects, matches, rows, evidence, seen.rays)
    return ComparedRegister(table, offset, survey)


def _places(table: pd.DataFrame) -> tuple[NDArray[np.float64], NDArray[np.str_]]:
    return table[["x", "y"]].to_numpy(dtype=np.float64), table["kind"].to_numpy(dtype=str)


def write_compared(
    compared: ComparedRegister, folder: Path, *, register: Path, warnings: Sequence[str] = ()
) -> list[Path]:
    """Write the states as a CSV table, a layer of a GeoPackage and a page with a map, each whole or not at all."""
    survey = compared.survey
    table = with_checked(compared.table.round(3), "register", survey.output.path)
    check_closed(folder / LAYER)
    write_atomic(folder / TABLE, without_formulas(table).to_csv(index=False, lineterminator="\n").encode())
    write_shapes({"register": points_of(table)}, folder / LAYER, crs=survey.inventory.crs)
    page = changes_page(
        table, _HEADINGS, map_of(survey, table), title=f"{register.name} and {survey.output.path.name}",
        subtitle=str(folder), layers=LAYER, warnings=warnings,
        facts={"register": str(register), "survey": str(survey.output.path), "offset": offset_text(compared.offset)},
    )  # fmt: skip
    write_atomic(folder / PAGE, page.encode())
    return [folder / TABLE, folder / LAYER, folder / PAGE]


def offset_text(offset: Offset) -> str:
    """Return how a register was moved."""
    if not offset.pairs:
        return "Too few entries have an object of their kind for an offset of the register: it was not moved."
    (x, y), (error_x, error_y) = offset.shift, offset.error
    return (
        f"The register was moved by {x:+.2f} m in x and {y:+.2f} m in y (standard errors {error_x:.2f} and "
        f"{error_y:.2f} m, {offset.pairs} pairs)."
    )

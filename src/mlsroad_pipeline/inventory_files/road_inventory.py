"""Road inventory of a survey: its table, the geometries of its files, and files that are written whole."""

import errno
import filecmp
import shutil
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd
import shapely
from pyproj import CRS
from pyproj.exceptions import CRSError

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.inventory.lines.extraction import LINE_FIELDS, line_fields_of_kind
from mlsroad_pipeline.algorithms.inventory.lines.layers import LINE_LAYERS
from mlsroad_pipeline.algorithms.inventory.objects.table import FIELDS, OBJECT_FIELDS, Field, fields_of_kind
from mlsroad_pipeline.algorithms.scenes.trajectory import Trajectory
from mlsroad_pipeline.execution.scratch import scratch_folder
from mlsroad_pipeline.formats.files import atomic_file

LAYERS = {"poles": "pole", "signs": "sign", "trees": "tree", "vehicles": "vehicle"}
"""Layer name to kind of object."""

MAY_LACK = (
    *("complete", "motion", "first_date", "facing_from", "pole_type", "panel_shape"),
    *("status", "checked_class", "reasons", "method", "model_version"),
)
"""Text columns whose empty values are NULL in files."""

ATTRIBUTE = "attr_"
"""Begin of the names of columns that hold the attributes that users gave to objects."""

DECIDED = ("key", "complete", "motion", "first_date", "pole_type", "panel_shape", "status", "checked_class")
"""Columns that files of earlier versions lack; they are read as empty."""


Layer = tuple[pd.DataFrame, np.ndarray, str]
"""Rows of a layer, their shapely shapes, and the type of the shapes, such as ``LineString Z``."""


@dataclass(frozen=True)
class RoadInventory:
    """Road objects of a survey, with their reference system and the trajectory."""

    objects: pd.DataFrame  # Columns of `OBJECT_FIELDS`, as `merge_across_scenes` returns them
    # Coordinate reference system as WKT or a code such as ``EPSG:25832``; None is written as undefined
    crs: str | None = None
    trajectory: Trajectory | None = None  # Trajectory of the scanner
    sections: pd.DataFrame | None = None  # Objects per section of the road, of `section_table`
    # Kerbs, wires and markings: columns of `LINE_FIELDS`, as `join_kerbs` returns them
    lines: pd.DataFrame | None = None
    # Measures of the road by layer, of `read_road`; empty where they were not measured
    road: Mapping[str, Layer] = field(default_factory=dict)


def fields_of_layer(layer: str) -> dict[str, Field]:
    """Return the columns of a layer of objects or lines, those of its kind alone; shapes are left out."""
    if layer in LINE_LAYERS:
        return {name: LINE_FIELDS[name] for name in line_fields_of_kind(LINE_LAYERS[layer]) if name != "line"}
    names = fields_of_kind(LAYERS[layer]) if layer in LAYERS else list(FIELDS)
    return {name: FIELDS[name] for name in names if name != "footprint"}


def note_columns(table: pd.DataFrame) -> list[str]:
    """Return the columns with the notes and attributes of users."""
    return [str(name) for name in table.columns if is_note(str(name))]


def is_note(name: str) -> bool:
    """Return whether a column holds notes or an attribute of users."""
    return name == "note" or name.startswith(ATTRIBUTE)


def note_field(name: str) -> Field:
    """Return heading and definition of a column of `note_columns`."""
    if name == "note":
        return Field("str", "Note", "Note of the check.")
    own = name.removeprefix(ATTRIBUTE)
    return Field("str", f"Attribute {own}", f"Attribute {own} that users gave in the check.")


def fields_with_notes(table: pd.DataFrame) -> dict[str, Field]:
    """Return the columns of a table of objects that are part of an inventory."""
    return FIELDS | {name: note_field(name) for name in note_columns(table)}


def checked(inventory: RoadInventory, target: Path) -> tuple[pd.DataFrame, CRS | None]:
    """Return the typed table and the reference system of an inventory; error messages name the target file."""
    missing = [name for name in OBJECT_FIELDS if name not in inventory.objects]
    if missing:
        raise DataError(f"{target}: the inventory lacks the column {missing[0]!r}")
    try:
        crs = None if inventory.crs is None else CRS.from_user_input(inventory.crs)
    except CRSError as error:
        raise DataError(f"{target}: the coordinate reference system {inventory.crs!r} is not understood") from error
    types = OBJECT_FIELDS | dict.fromkeys(note_columns(inventory.objects), "str")
    return inventory.objects[list(types)].astype(types).reset_index(drop=True), crs


def attributes(table: pd.DataFrame) -> pd.DataFrame:
    """Return all columns but the footprint, with None in place of empty text."""
    columns = table[[name for name in fields_with_notes(table) if name != "footprint"]].copy()
    for name in (*MAY_LACK, *note_columns(table)):
        columns[name] = columns[name].astype(object).where(columns[name] != "", None)
    return columns


def with_empty_text(objects: pd.DataFrame) -> pd.DataFrame:
    """Return a table read from a file with empty text in place of missing values: the inverse of `attributes`."""
    columns = pd.DataFrame(objects)
    columns = columns.assign(**{name: "" for name in DECIDED if name not in columns})
    for name in (*MAY_LACK, *note_columns(columns)):
        columns[name] = columns[name].astype(object).where(columns[name].notna(), "")
    types = OBJECT_FIELDS | dict.fromkeys(note_columns(columns), "str")
    return columns[list(types)].astype(types)


def base_points(table: pd.DataFrame) -> np.ndarray:
    """Return the base points of objects as shapely points with heights."""
    points: np.ndarray = shapely.points(table[["x", "y", "z"]].to_numpy())
    return points


def hulls(table: pd.DataFrame) -> np.ndarray:
    """Return the footprints of objects as counterclockwise shapely polygons, None for those without area."""
    shapes: np.ndarray = shapely.from_wkt([text or None for text in table["footprint"]])
    return shapes


def line_shapes(lines: pd.DataFrame) -> np.ndarray:
    """Return the lines of a table as shapely lines with heights."""
    shapes: np.ndarray = shapely.from_wkt(lines["line"].to_numpy(dtype=object))
    return shapes


def line_vertices(lines: pd.DataFrame) -> list[np.ndarray]:
    """Return the vertices of the lines of a table, (k, 3) each, metres."""
    return [shapely.get_coordinates(shape, include_z=True) for shape in line_shapes(lines)]


def path_of(trajectory: Trajectory) -> tuple[pd.DataFrame, np.ndarray]:
    """Return the length of a trajectory, as a table, and its line."""
    line = np.array([shapely.LineString(trajectory.xyz)])
    return pd.DataFrame({"length": [round(trajectory.length, 3)]}), line


def line_attributes(lines: pd.DataFrame) -> pd.DataFrame:
    """Return the columns of lines but their shapes."""
    return lines[[name for name in LINE_FIELDS if name != "line"]].reset_index(drop=True)


def footprint_text(shapes: np.ndarray) -> np.ndarray:
    """Return footprints as WKT with two decimals (1 cm), empty text for None: the inverse of `hulls`."""
    text = shapely.to_wkt(shapes, rounding_precision=2, trim=False)
    return np.where(shapely.is_missing(shapes), "", text)


def vehicle_boxes(objects: pd.DataFrame) -> np.ndarray:
    """Return the oriented boxes of vehicles as counterclockwise polygons at the height of their base.

    Vehicles without a measure, such as those that a user added, have none.
    """
    centre = objects[["x", "y"]].to_numpy()
    turn = np.radians(objects["heading"].to_numpy())
    along = np.column_stack([np.sin(turn), np.cos(turn)]) * objects["length"].to_numpy()[:, None] / 2
    across = np.column_stack([-np.cos(turn), np.sin(turn)]) * objects["width"].to_numpy()[:, None] / 2
    corners = np.stack(
        [centre - along - across, centre + along - across, centre + along + across, centre - along + across], 1
    )
    heights = np.repeat(objects["z"].to_numpy()[:, None, None], 4, axis=1)
    rings = np.concatenate([corners, heights], axis=2)
    measured = np.isfinite(rings).all(axis=(1, 2))
    boxes: np.ndarray = np.full(len(rings), None, dtype=object)
    boxes[measured] = shapely.polygons(rings[measured])
    return boxes


def write_whole(folder: Path, write: Callable[[Path], None]) -> list[Path]:
    """Write files by a function of a folder, each whole or not at all.

    The function writes into two folders for temporary files. If the files are equal, they are copied to their place.
    """
    with tempfile.TemporaryDirectory(dir=scratch_folder()) as place:
        first, second = Path(place, "first"), Path(place, "second")
        for twin in (first, second):
            twin.mkdir()
            write(twin)
        names = sorted(path.name for path in first.iterdir())
        if names != sorted(path.name for path in second.iterdir()) or any(
            not filecmp.cmp(first / name, second / name, shallow=False) for name in names
        ):
            raise OSError(errno.EIO, f"GDAL did not write all of {', '.join(names)} below {place}", str(folder))
        for name in names:
            with (first / name).open("rb") as source, atomic_file(folder / name) as stream:
                shutil.copyfileobj(source, stream)
    return [folder / name for name in names]

"""Tables of true objects: of simulated streets, of users, and made from instances and boxes of recordings."""

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
import shapely
from numpy.typing import NDArray
from pandas.api.types import is_string_dtype

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY, TAXONOMY_NAMES
from mlsroad_pipeline.algorithms.core.exceptions import DataError, ReadError
from mlsroad_pipeline.algorithms.core.plain_text import printable
from mlsroad_pipeline.algorithms.inventory.objects.boxes import vehicle_box
from mlsroad_pipeline.algorithms.inventory.objects.rules import KIND_OF_CLASS, KINDS, ObjectRule
from mlsroad_pipeline.formats.base import ReadOptions
from mlsroad_pipeline.formats.files import named_errors
from mlsroad_pipeline.formats.registry import get_format

LEAST_POINTS = {kind: ObjectRule.of_kind(kind, (0,)).min_points for kind in sorted(set(KIND_OF_CLASS.values()))}
"""Kind to the fewest points that an object of the inventory has; true objects with fewer do not count."""
STANDING, MOVING = (10, 13, 15, 16, 18, 20), (252, 256, 257, 258, 259)
"""Codes of vehicles in SemanticKITTI."""
_PANDASET_VEHICLES = (
    *("Car", "Pickup Truck", "Medium-sized Truck", "Semi-truck", "Bus", "Emergency Vehicle", "Train", "Towed Object"),
    *("Tram / Subway", "Other Vehicle - Construction Vehicle", "Other Vehicle - Uncommon"),
)
_NUMBERS = (
    *("x", "y", "z", "height", "width", "length", "heading", "tilt", "lean_azimuth", "diameter", "crown_diameter"),
    *("panel_bottom", "panel_centre", "panel_height", "panel_width", "facing", "points"),
)
"""Numeric columns that a table may have."""


class Truth(NamedTuple):
    """True objects of a survey."""

    # `kind`, `x`, `y`, `counted` (False for moving objects and those outside the truth), and measures with the names of
    # the inventory, where they are known; `points` and `instance` where they are known
    objects: pd.DataFrame
    region: shapely.Geometry | None  # Where the truth is complete, in plan; None is everywhere
    source: str  # Kind of table: ``simulated``, ``table``, ``pandaset``, ``kitti`` or ``semantickitti``


def read_truth(path: str | Path) -> Truth:
    """Read a table of true objects in the format that its content has.

    A folder is that of a simulated street. Raises ReadError or DataError, whose message names the file.
    """
    place = Path(path)
    place = place / "objects.csv" if place.is_dir() else place
    if not place.is_file():
        raise ReadError(f"{place} does not exist: name a table of true objects, or the folder of a simulated street")
    with named_errors(place, "a table of true objects"):
        return _read_truth(place)


def _read_truth(place: Path) -> Truth:
    if place.suffix == ".label":
        return Truth(_semantickitti(place), None, "semantickitti")
    if place.suffix == ".txt":
        objects, region = _kitti_boxes(place)
        return Truth(typed_objects(objects, place), region, "kitti")
    table = read_csv(place)
    if {"instance", "label", "box_x", "moving"} <= set(table):
        return Truth(typed_objects(_simulated(table), place), None, "simulated")
    if {"position.x", "dimensions.x", "yaw"} <= set(table):
        return Truth(typed_objects(_pandaset(table), place), None, "pandaset")
    typed = typed_objects(table, place)
    if typed.empty:
        raise DataError(f"{place}: the table has no true objects")
    return Truth(typed, None, "table")


def read_csv(place: Path, numbers: Collection[str] = ()) -> pd.DataFrame:
    """Return a table separated by commas, or by semicolons with decimal commas as spreadsheets write it.

    Columns of `numbers` and those of this module are numeric.
    """
    try:
        with place.open(encoding="utf-8-sig") as stream:
            header = stream.readline()
        spreadsheet = ";" in header and "," not in header
        table = pd.read_csv(place, sep=";" if spreadsheet else ",", encoding="utf-8-sig")
    except (pd.errors.ParserError, pd.errors.EmptyDataError, UnicodeDecodeError) as error:
        raise ReadError(f"{place}: not a table of objects: {' '.join(str(error).split())}") from error
    commas = [name for name in {*_NUMBERS, *numbers} if spreadsheet and name in table and is_string_dtype(table[name])]
    return table.assign(**{name: table[name].str.replace(",", ".", regex=False) for name in commas})


def typed_objects(table: pd.DataFrame, place: Path) -> pd.DataFrame:
    """Return a table with numbers and without objects of no kind, or raise an error that names file and column."""
    missing = [name for name in ("kind", "x", "y") if name not in table]
    if missing:
        columns = printable(", ".join(map(str, table)))
        raise DataError(f"{place}: a table of true objects needs the column {missing[0]} (has {columns})")
    table = table[table["kind"].notna()]
    kinds = table["kind"].astype(str).str.strip().str.lower()
    _check(table["kind"], ~kinds.isin(KINDS), place, f"kinds are {', '.join(KINDS)}")
    for name in (name for name in _NUMBERS if name in table):
        values = pd.to_numeric(table[name], errors="coerce")
        _check(table[name], values.isna() & table[name].notna(), place, "it is not a number")
        if name in ("x", "y"):
            _check(table[name], ~np.isfinite(values), place, "a place needs x and y")
        table = table.assign(**{name: values.astype(np.float64)})
    given = table["counted"] if "counted" in table else pd.Series(True, index=table.index)
    counted = given.astype(str).str.lower().map({"true": True, "1": True, "false": False, "0": False})
    _check(given, counted.isna(), place, "write true or false")
    return table.assign(kind=kinds, counted=counted.astype(bool)).reset_index(drop=True)


def _check(column: pd.Series, bad: pd.Series, place: Path, text: str) -> None:
    """Raise an error that names the first bad value of a column and its row; rows count from 1, without the header."""
    rows = np.flatnonzero(bad)
    if len(rows):
        cell = column.iloc[rows[0]]
        value = "an empty cell" if pd.isna(cell) else repr(cell)
        raise DataError(f"{place}: column {column.name} has {value} in row {column.index[rows[0]] + 1}: {text}")


def _simulated(table: pd.DataFrame) -> pd.DataFrame:
    """Return the simulator's table with names, units and positions of the inventory."""
    kind = table["label"].map(lambda code: KIND_OF_CLASS.get(TAXONOMY_NAMES[code]))
    vehicle, panel = kind == "vehicle", (kind == "sign") & table["panel_x"].notna()
    heading = (90.0 - np.degrees(table["heading"])) % 180.0
    out = table.assign(
        kind=kind,
        name=table["label"].map(lambda code: TAXONOMY_NAMES[code]) + " " + table["design"].astype(str),
        x=table["x"].where(~vehicle, table["box_x"]).where(~panel, table["panel_x"]),
        y=table["y"].where(~vehicle, table["box_y"]).where(~panel, table["panel_y"]),
        heading=heading.where(vehicle),
        facing=table["panel_azimuth"],
        two_sided=table["design"] == "street_name_sign",
        # Cycas are low vegetation of most class schemes: a listed one is neither right nor false.
        counted=~table["moving"].astype(bool) & (table["label"] != TAXONOMY["cycas"]),
    )
    out.loc[~vehicle, ["length", "width"]] = np.nan  # sides of the model's box, which are other measures
    # A plate on a lamp or signal has no instance of its own, so its points are unknown: a listed sign there is ignored.
    held = out[(kind != "sign") & out["panel_x"].notna()]
    held = held.assign(kind="sign", name="plate on " + held["name"], counted=False)
    out = pd.concat([out, held.assign(x=held["panel_x"], y=held["panel_y"])], ignore_index=True)
    return out.drop(columns=["box_x", "box_y", "panel_x", "panel_y", "panel_azimuth", "label", "moving"])


def _pandaset(table: pd.DataFrame) -> pd.DataFrame:
    """Return the vehicles of a table of cuboids; those seen by both scanners have two, of which one is kept."""
    twice = (table.get("cuboids.sensor_id", pd.Series(-1, index=table.index)) == 1) & (
        table.get("cuboids.sibling_id", pd.Series("-", index=table.index)).astype(str) != "-"
    )
    rows = table[table["label"].isin(_PANDASET_VEHICLES) & ~twice].reset_index(drop=True)
    return pd.DataFrame(
        {
            "kind": "vehicle",
            "name": rows["label"],
            "x": rows["position.x"],
            "y": rows["position.y"],
            "z": rows["position.z"] - rows["dimensions.z"] / 2,
            "width": rows["dimensions.x"],
            "length": rows["dimensions.y"],
            "height": rows["dimensions.z"],
            "heading": -np.degrees(rows["yaw"]) % 180.0,
            "counted": rows["stationary"].astype(bool),
        }
    )


def _semantickitti(place: Path) -> pd.DataFrame:
    """Return the vehicles of a labelled scan: boxes of the points of each instance."""
    names = [
        place.with_suffix(".bin"),
        *(place.parents[1] / part / f"{place.stem}.bin" for part in ("velodyne", "pcd")),
    ]
    scan = next((name for name in names if name.is_file()), None)
    if scan is None:
        raise ReadError(f"{place}: the scan {place.stem}.bin lies neither beside it nor in ../velodyne")
    xyz = get_format(scan).read(scan, ReadOptions(only=())).world_xyz()
    packed = np.fromfile(place, "<u4")
    if len(packed) != len(xyz):
        raise DataError(f"{place} has {len(packed)} labels for the {len(xyz)} points of {scan}")
    code, number = packed & 0xFFFF, packed >> 16
    rows = [
        {"kind": "vehicle", "name": f"{code[mine][0]}", "instance": int(n), "points": int(mine.sum()),
         "counted": bool(np.isin(code[mine], STANDING).all()), **_box(xyz[mine])}
        for n in np.unique(number[np.isin(code, (*STANDING, *MOVING)) & (number > 0)])
        for mine in [(number == n) & np.isin(code, (*STANDING, *MOVING))]
    ]  # fmt: skip
    columns = ["kind", "name", "instance", "points", "counted", "x", "y", "z", "height", "length", "width", "heading"]
    return pd.DataFrame(rows, columns=columns)


def _box(xyz: NDArray[np.float64]) -> dict[str, float]:
    box = vehicle_box(xyz[:, :2])
    low, high = float(xyz[:, 2].min()), float(xyz[:, 2].max())
    place = {"x": float(box.centre[0]), "y": float(box.centre[1]), "z": low, "height": high - low}
    return {**place, "length": box.length, "width": box.width, "heading": box.azimuth}


_KITTI_VEHICLES = ("Car", "Van", "Truck", "Tram")
_KITTI_REACH = 80.0
"""Range up to which the labels are complete, metres."""


def _kitti_boxes(path: Path) -> tuple[pd.DataFrame, shapely.Geometry]:
    """Return the vehicles of ``label_2/NAME.txt``, and where they are complete; reads ``calib/NAME.txt`` too.

    The labels cover what the left colour camera sees, without the directions that they mark as unknown.
    """
    calibration = path.parents[1] / "calib" / path.name
    if not calibration.is_file():
        raise ReadError(f"{path}: the calibration {calibration} does not exist")
    rows = [line.split() for line in path.read_text(encoding="utf-8").splitlines() if line.strip()]
    try:
        matrices = _matrices(calibration)
        boxes = pd.DataFrame(
            [_kitti_box(row, matrices["to_scan"]) for row in rows if row[0] in _KITTI_VEHICLES], columns=_BOX_COLUMNS
        )
        unknown = [(float(row[4]), float(row[6])) for row in rows if row[0] == "DontCare"]
        camera = matrices["P2"]
        seen = _wedge(camera, 0.0, 2 * camera[0, 2])  # the principal point is the middle of the image
        region = shapely.difference(seen, shapely.union_all([_wedge(camera, *limits) for limits in unknown]))
    except (ValueError, IndexError, KeyError, shapely.errors.ShapelyError) as error:  # the last for NaN
        raise ReadError(f"{path}: not a KITTI label file: {error}") from error
    return boxes, region


_BOX_COLUMNS = ["kind", "name", "x", "y", "z", "height", "width", "length", "heading"]


def _matrices(path: Path) -> dict[str, NDArray[np.float64]]:
    values = {}
    for line in path.read_text(encoding="utf-8").splitlines():
        name, sign, numbers = line.partition(":")
        if sign:
            values[name] = np.array(numbers.split(), dtype=np.float64)
    rectify, camera = np.eye(4), np.eye(4)
    rectify[:3, :3] = values["R0_rect"].reshape(3, 3)
    camera[:3] = values["Tr_velo_to_cam"].reshape(3, 4)
    to_scan: NDArray[np.float64] = np.linalg.inv(rectify @ camera).astype(np.float64)
    return {"P2": values["P2"].reshape(3, 4), "to_scan": to_scan}


def _kitti_box(row: list[str], to_scan: NDArray[np.float64]) -> list[object]:
    height, width, length, x, y, z, turn = (float(value) for value in row[8:15])
    place = to_scan @ [x, y, z, 1.0]
    along = to_scan[:3, :3] @ [np.cos(turn), 0.0, -np.sin(turn)]
    heading = np.degrees(np.arctan2(along[0], along[1])) % 180.0
    return ["vehicle", row[0], *place[:3], height, width, length, heading]


def _wedge(camera: NDArray[np.float64], left: float, right: float) -> shapely.Polygon:
    """Return what lies between two columns of the image in plan, x forward and y to the left."""
    slopes = [(camera[0, 2] - column) / camera[0, 0] for column in (left, right)]
    return shapely.Polygon([(0.0, 0.0), *((_KITTI_REACH, _KITTI_REACH * slope) for slope in slopes)])


def point_counts(truth: Truth, clouds: Sequence[Path]) -> pd.Series | None:
    """Return the points of each true object in the clouds: of its instance, or in its box; None where unknown.

    The labelled clouds of a simulated street keep the simulator's `instance`.
    """
    objects = truth.objects
    if "points" in objects:
        return objects["points"]
    boxed = {"z", "length", "width", "height", "heading"} <= set(objects) and bool((objects["kind"] == "vehicle").all())
    if not clouds or not ("instance" in objects or boxed):
        return None
    total = np.zeros(len(objects), np.int64)
    for path in clouds:
        form = get_format(path)
        info = form.info(path, ReadOptions())
        by_number = "instance" in objects and "instance" in info.columns
        if not by_number and not boxed:
            return None
        for start in range(0, info.n_points, CHUNK):
            options = ReadOptions(only=("instance",) if by_number else ())
            cloud = form.read(path, options, start=start, stop=start + CHUNK)
            total += (
                objects["instance"].map(pd.Series(cloud["instance"]).value_counts()).fillna(0).to_numpy(np.int64)
                if by_number
                else _in_boxes(objects, cloud.world_xyz())
            )
    return pd.Series(total, index=objects.index)


CHUNK = 2_000_000
"""Points of a cloud that are read at once."""
_BOX_MARGIN = 0.1  # metres


def _in_boxes(objects: pd.DataFrame, xyz: NDArray[np.float64]) -> NDArray[np.int64]:
    return np.array([len(rows) for rows in points_of_boxes(objects, xyz)], dtype=np.int64)


def points_of_boxes(objects: pd.DataFrame, xyz: NDArray[np.float64]) -> list[NDArray[np.int64]]:
    """Return the rows of the points in the box of each true object."""
    found = []
    for row in objects.to_dict("records"):
        near = np.flatnonzero(np.abs(xyz[:, :2] - [row["x"], row["y"]]).max(axis=1) <= row["length"])
        turn, off = np.radians(row["heading"]), xyz[near, :2] - [row["x"], row["y"]]
        along, across = off @ [np.sin(turn), np.cos(turn)], off @ [np.cos(turn), -np.sin(turn)]
        up = xyz[near, 2] - row["z"]
        inside = np.abs(along) <= row["length"] / 2 + _BOX_MARGIN
        inside &= np.abs(across) <= row["width"] / 2 + _BOX_MARGIN
        found.append(near[inside & (up > _BOX_MARGIN) & (up < row["height"] + _BOX_MARGIN)])
    return found


def instances_of_objects(truth: Truth, clouds: Sequence[Path]) -> pd.Series:
    """Return the true object to which more than half of the points of each listed object belong, by `object_id`.

    Empty without clouds that have both `instance` and `object_id`.
    """
    pairs = [pd.DataFrame({"object_id": [], "instance": []}, dtype=np.int64)]
    for path in clouds if "instance" in truth.objects else ():
        form = get_format(path)
        info = form.info(path, ReadOptions())
        if not {"instance", "object_id"} <= set(info.columns):
            continue
        for start in range(0, info.n_points, CHUNK):
            cloud = form.read(path, ReadOptions(only=("instance", "object_id")), start=start, stop=start + CHUNK)
            numbers = pd.DataFrame({name: cloud[name].astype(np.int64) for name in ("object_id", "instance")})
            pairs.append(numbers[numbers["object_id"] > 0])
    points = pd.concat(pairs).value_counts().reset_index(name="n")
    share = points["n"] / points.groupby("object_id")["n"].transform("sum")
    return points[share > 0.5].set_index("object_id")["instance"]


def counted_objects(truth: Truth, counts: pd.Series | None, least: Mapping[str, int]) -> pd.DataFrame:
    """Return the true objects, of which those with too few points do not count; a user's table counts as it is."""
    objects = truth.objects
    if counts is None:
        return objects
    limits = {**({} if truth.source == "table" else LEAST_POINTS), **least}
    enough = counts.to_numpy() >= np.array([limits.get(kind, 0) for kind in objects["kind"]], dtype=np.float64)
    return objects.assign(points=counts, counted=objects["counted"] & enough)

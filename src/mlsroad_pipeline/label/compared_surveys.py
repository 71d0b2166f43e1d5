"""Comparison of two labelled surveys of one place: offset, objects, surfaces."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
import shapely
from numpy.typing import NDArray
from pyproj import CRS
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.geometry.thinning import first_in_cells
from mlsroad_pipeline.algorithms.inventory.changes.surfaces import (
    SURFACES,
    M3C2Parameters,
    SurfaceDistances,
    surface_distances,
)
from mlsroad_pipeline.algorithms.inventory.objects.class_groups import GROUPS, group_shares
from mlsroad_pipeline.algorithms.registration.offset import Offset, find_offset
from mlsroad_pipeline.inventory_files.road_inventory import RoadInventory, line_vertices
from mlsroad_pipeline.label.compared_lines import ComparedLines, compared_lines
from mlsroad_pipeline.label.compared_objects import compared_objects
from mlsroad_pipeline.label.labelled_clouds import Recorded

TABLE = "changes.csv"
"""File with the states and keys of a comparison."""
THINNED = 0.05
"""Edge of the cells of which one point of a surface is kept, metres."""
_APART = 100.0  # distance of the objects of two surveys that have nothing in common, metres
NEAR_KERB = 0.2
"""Distance of a core point from a kerb up to which it is of the kerb, metres."""
_FACADE, _ROAD = SURFACES.index("facade"), SURFACES.index("road")
_KERB_STEP = 0.1  # between the points of kerbs, metres


class ComparedSurveys(NamedTuple):
    """States of all objects, distances of surfaces, and the offset of the earlier survey."""

    objects: pd.DataFrame  # Of `changed_objects`, with `key`
    lines: ComparedLines
    surfaces: SurfaceDistances | None
    offset: Offset | None  # What moves the earlier survey onto the later one; None where nothing measures it
    aligned: bool  # Whether the earlier survey was moved
    first: Recorded  # As compared
    second: Recorded

    @property
    def registration_error(self) -> float:
        """Length of the offset that remains, or its standard error, metres; NaN where it is not known."""
        return np.nan if self.offset is None else _remaining(self.offset, aligned=self.aligned)


def compare_surveys(first: Recorded, second: Recorded, *, align: bool, surfaces: bool) -> ComparedSurveys:
    """Compare an earlier with a later survey of one place.

    `align` moves the earlier survey by the offset of unchanged surfaces; else the offset is only measured.
    """
    _check_systems(first, second)
    _check_places(first, second)
    points = [surface_points(survey) for survey in (first, second)]
    origin = np.floor(points[1].xyz.mean(axis=0)) if len(points[1].xyz) else np.zeros(3)
    offset = find_offset(points[1].xyz - origin, points[0].xyz - origin) if all(len(p.xyz) for p in points) else None
    if align:
        if offset is None:
            raise DataError(f"{first.output.path}: no surfaces measure an offset: compare without --align")
        measured = offset

        def move(xyz: NDArray[np.float64]) -> NDArray[np.float64]:
            return measured.apply(xyz - origin) + origin

        first = first.moved(move)
        points[0] = points[0]._replace(xyz=move(points[0].xyz))
    objects = compared_objects(first, second)
    objects.insert(0, "key", keys_of(objects, first, second))
    found = None
    if surfaces:
        error = 0.0 if offset is None else _remaining(offset, aligned=align)
        found = compared_surfaces(points[0], points[1], second, error)
    return ComparedSurveys(objects, compared_lines(first, second), found, offset, align, first, second)


def _check_places(first: Recorded, second: Recorded) -> None:
    """Raise DataError where two surveys lie apart."""
    boxes = [shapely.MultiPoint(survey.objects[["x", "y"]].to_numpy()).envelope for survey in (first, second)]
    metres = 0.0 if any(box.is_empty for box in boxes) else float(shapely.distance(*boxes))
    if metres > _APART:
        raise DataError(f"{first.output.path} and {second.output.path} lie {metres:,.0f} m apart: nothing is compared")


def _check_systems(first: Recorded, second: Recorded) -> None:
    systems = [survey.inventory.crs for survey in (first, second)]
    if None not in systems and not CRS.from_user_input(systems[0]).equals(CRS.from_user_input(systems[1])):
        names = [CRS.from_user_input(system).name for system in systems]
        raise ParameterError(
            f"{first.output.path} is in {names[0]} and {second.output.path} in {names[1]}: label one again in the "
            "system of the other (--params label.read.reproject=EPSG:...)"
        )


def _remaining(offset: Offset, *, aligned: bool) -> float:
    return float(np.linalg.norm(np.nan_to_num(offset.error if aligned else offset.shift)))


def keys_of(objects: pd.DataFrame, first: Recorded, second: Recorded) -> list[str]:
    """Return the key of each object: that of the earlier survey, from its own comparison where it has one."""
    own = [dict(zip(s.objects["object_id"].tolist(), s.objects["key"], strict=True)) for s in (first, second)]
    own[0] |= _known_keys(first.output.path)
    numbers = zip(objects["first_id"].tolist(), objects["second_id"].tolist(), strict=True)
    return [str(own[0][one] if one else own[1][other]) for one, other in numbers]


def _known_keys(folder: Path) -> dict[int, str]:
    """Return the keys that an earlier comparison gave to the objects of a survey."""
    path = folder / "changes" / TABLE
    if not path.is_file():
        return {}
    table = pd.read_csv(path)
    if not {"key", "second_id"} <= set(table):
        raise DataError(f"{path}: no columns key and second_id: it is no result of compare; remove or rename it")
    own = table[table["second_id"] > 0]
    return dict(zip(own["second_id"].astype(int), own["key"].astype(str), strict=True))


class SurfacePoints(NamedTuple):
    """Thinned points of paved ground and of facades."""

    xyz: NDArray[np.float64]
    surface: NDArray[np.uint8]


def surface_points(survey: Recorded) -> SurfacePoints:
    """Return the points of surfaces of a survey, one per `THINNED`."""
    xyz, surface = [np.zeros((0, 3))], [np.zeros(0, np.uint8)]
    for cloud in survey.clouds:
        number = _surfaces_of(cloud.scheme)
        for points, code, _ in cloud.chunks():
            own = number[cloud.label[code]]
            kept = np.flatnonzero(own < len(SURFACES))
            kept = kept[first_in_cells(points[kept], THINNED)]
            xyz.append(points[kept])
            surface.append(own[kept])
    points, own = np.concatenate(xyz), np.concatenate(surface)
    kept = first_in_cells(points, THINNED) if len(points) else np.zeros(0, np.int64)
    return SurfacePoints(points[kept], own[kept])


def _surfaces_of(scheme: ClassScheme) -> NDArray[np.uint8]:
    """Return the number of the surface of each class; the last entry is that of points without a class."""
    shares = group_shares(scheme)
    number = np.full(len(scheme) + 1, len(SURFACES), dtype=np.uint8)
    number[:-1][shares[:, GROUPS.index("paved ground")] >= 0.5] = _ROAD
    number[:-1][shares[:, GROUPS.index("building")] >= 0.5] = _FACADE
    return number


def compared_surfaces(
    first: SurfacePoints, second: SurfacePoints, later: Recorded, registration_error: float
) -> SurfaceDistances:
    """Return the M3C2 distances of road, kerbs and facades at core points of the earlier survey."""
    parameters, core, surface = M3C2Parameters(), [np.zeros((0, 3))], [np.zeros(0, np.uint8)]
    for number in (_ROAD, _FACADE):
        own = first.xyz[first.surface == number]
        core.append(own[first_in_cells(own, parameters.spacing)] if len(own) else own)
        surface.append(np.full(len(core[-1]), number, dtype=np.uint8))
    places, numbers = np.concatenate(core), np.concatenate(surface)
    kerbs = _kerb_points(later.inventory)
    if len(kerbs) and len(places):
        near = cKDTree(kerbs).query(places[:, :2], distance_upper_bound=NEAR_KERB)[0] <= NEAR_KERB
        numbers[near & (numbers == _ROAD)] = SURFACES.index("kerb")
    parts = []
    for facade in (False, True):
        before, after = (points.xyz[(points.surface == _FACADE) == facade] for points in (first, second))
        own = (numbers == _FACADE) == facade
        parts.append(
            surface_distances(
                before, after, places[own], numbers[own], later.path, registration_error=registration_error,
                parameters=parameters,
            )
        )  # fmt: skip
    return SurfaceDistances(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def _kerb_points(inventory: RoadInventory) -> NDArray[np.float64]:
    """Return points on the kerbs of an inventory in plan, at most `_KERB_STEP` apart."""
    if inventory.lines is None:
        return np.zeros((0, 2))
    found = [np.zeros((0, 2))]
    for line in line_vertices(inventory.lines[inventory.lines["kind"] == "kerb"]):
        along = np.append(0.0, np.cumsum(np.hypot(*np.diff(line[:, :2], axis=0).T)))
        at = np.linspace(0.0, along[-1], int(along[-1] / _KERB_STEP) + 2)
        found.append(np.column_stack([np.interp(at, along, axis) for axis in line[:, :2].T]))
    return np.concatenate(found)

"""Measures of the road of a labelled survey: two readings of its points, ground first, then what stands above it."""

import logging
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.core.codings import NOISE_CODES
from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.inventory.lines.kerbs.kerb_lines import ground_classes
from mlsroad_pipeline.algorithms.inventory.lines.markings.marking_lines import paved_classes
from mlsroad_pipeline.algorithms.inventory.objects.sections import equal_sections, section_table
from mlsroad_pipeline.algorithms.inventory.road.clearance import (
    BESIDE,
    FROM,
    HIGHEST,
    LOWEST,
    Lowest,
    above_road,
    lowest_points,
)
from mlsroad_pipeline.algorithms.inventory.road.edges import find_edges
from mlsroad_pipeline.algorithms.inventory.road.places import CLEARANCE, road_places
from mlsroad_pipeline.algorithms.inventory.road.sight import Standing, joined, may_hide, sight_table, standing
from mlsroad_pipeline.algorithms.inventory.road.stations import STEP, Located, RoadPath, check_driven
from mlsroad_pipeline.algorithms.inventory.road.surface import (
    CELL,
    CELLS,
    Ground,
    Planes,
    fit_planes,
    surface_heights,
)
from mlsroad_pipeline.algorithms.inventory.road.table import road_table, section_medians
from mlsroad_pipeline.algorithms.scenes.corridor import MainAxis, main_axis
from mlsroad_pipeline.algorithms.scenes.trajectory import Trajectory
from mlsroad_pipeline.formats.las.header import class_names, read_header
from mlsroad_pipeline.formats.registry import get_format
from mlsroad_pipeline.inventory_files.cross_sections import CrossSection
from mlsroad_pipeline.inventory_files.road_inventory import RoadInventory, line_vertices
from mlsroad_pipeline.label.labelled_clouds import kept_codes
from mlsroad_pipeline.review.corrections.labelled_output import LabelledOutput

logger = logging.getLogger(__name__)

CHUNK = 2_000_000
"""Points that are read at once."""
SLICE = 0.25
"""Largest distance along the path of the points of a section across the road, metres."""

_MOBILE = {"car", "van", "truck", "bus", "train", "other_vehicle", "motorcycle", "bicycle", "person", "rider", "animal"}
"""Taxonomy classes that do not stay above the road."""
_NOTHING = standing(np.zeros((0, 3)), np.zeros(0, np.uint8))
_SAMPLED = 50  # every such ground point gives the main axis
_UNKNOWN = 255  # class of points without one


class MeasuredRoad(NamedTuple):
    """Measures of a road by station and section, its path, and the sections across it that were asked for."""

    table: pd.DataFrame  # Columns of `ROAD_FIELDS`
    sections: pd.DataFrame  # Objects and medians per section
    path: RoadPath
    across: list[CrossSection]
    crs: str | None
    sight: pd.DataFrame  # Columns of `SIGHT_FIELDS`
    places: pd.DataFrame  # Columns of `PLACE_FIELDS`


class _Points(NamedTuple):
    """Points of a part of a labelled cloud, in world coordinates, with class and object."""

    xyz: NDArray[np.float64]
    label: NDArray[np.uint8]
    number: NDArray[np.uint32]


@dataclass(frozen=True)
class _Clouds:
    """The labelled points of a survey, and the roles of their classes."""

    output: LabelledOutput
    scheme: ClassScheme
    label_of_code: NDArray[np.uint8]  # `_UNKNOWN` where a code is no class

    @classmethod
    def of(cls, output: LabelledOutput) -> "_Clouds":
        path = next(iter(output.clouds().values()))
        scheme = output.model_scheme(class_names(read_header(path)))
        if scheme is None:
            raise DataError(
                f"{path}: the scheme of its model is not configured (classes.schemes), so its codes have no meaning"
            )
        if not paved_classes(scheme).any():
            raise DataError(f"{path}: its classes have no paved ground, so the road is not known")
        labels = np.full(256, _UNKNOWN, dtype=np.uint8)
        codes = scheme.codes(output.written_scheme)
        labels[codes] = np.arange(len(scheme))
        for number, label in kept_codes(output, scheme).items():
            labels[number] = label
        return cls(output, scheme, labels)

    def roles(self) -> tuple[NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_]]:
        """Return which labels are ground, natural ground, and fixed above it; by label up to `_UNKNOWN`."""
        ground, natural, fixed = np.zeros((3, _UNKNOWN + 1), dtype=np.bool_)
        n = len(self.scheme)
        ground[:n] = ground_classes(self.scheme)
        natural[:n] = ground[:n] & ~paved_classes(self.scheme)
        fixed[:n] = ~ground[:n] & [not _MOBILE & set(members) for members in self.scheme.members]
        return ground, natural, fixed

    def chunks(self) -> Iterator[_Points]:
        """Yield the points of a part of a file; noise is left out."""
        for path in self.output.clouds().values():
            form, options = get_format(path), self.output.read_options()
            info = form.info(path, options)
            names = tuple(name for name in ("classification", "object_id") if name in info.columns)
            for start in range(0, info.n_points, CHUNK):
                cloud = form.read(path, replace(options, only=names), start=start, stop=start + CHUNK)
                cloud = cloud.select(~np.isin(cloud["classification"], NOISE_CODES))
                number = cloud.get("object_id")
                number = np.zeros(len(cloud), np.uint32) if number is None else number.astype(np.uint32)
                label = self.label_of_code[cloud["classification"].astype(np.uint8)]
                yield _Points(cloud.world_xyz(), label, number)


def measure_road(
    output: LabelledOutput,
    inventory: RoadInventory,
    *,
    trajectory: Trajectory | None = None,
    envelope: tuple[float, float] | None = None,
    at: Sequence[float] = (),
) -> MeasuredRoad:
    """Measure the road of a labelled survey along a trajectory, by default that of the inventory.

    `envelope` are the width and height of an envelope around the path, `at` the stations of sections across the road.
    """
    clouds = _Clouds.of(output)
    if trajectory is not None:
        check_driven(trajectory)
    found = trajectory or inventory.trajectory or _axis_of_ground(clouds)
    path = RoadPath.along(found)
    for station in at:
        if not 0 <= station <= path.station[-1]:
            raise ParameterError(f"--at {station:g}: the path has stations from 0 to {path.station[-1]:g}")
    ground = _read_ground(clouds, path)
    kerbs = inventory.lines
    edges = find_edges(path, ground, [] if kerbs is None else line_vertices(kerbs[kerbs["kind"] == "kerb"]))
    planes = fit_planes(ground, edges.offset)
    if not np.isfinite(planes.height).any():
        raise DataError(
            f"{output.path}: no paved ground within 1.5 m of the path {found.source}: name the path of the vehicle "
            "with --path"
        )
    signs = inventory.objects[inventory.objects["kind"] == "sign"]
    above = _Above.empty(len(path), envelope, at, hides=len(signs) > 0)
    above.read(clouds, path, ground, planes, np.where(np.isfinite(edges.offset), edges.offset, [[-BESIDE], [BESIDE]]))
    inside = None if envelope is None else lowest_points(above.inside)
    table = road_table(path, ground, planes, edges, lowest_points(above.over), inside, clouds.scheme.classes)
    surface = surface_heights(ground, planes) + ground.base
    across = [
        _cross_section(station, parts, table, surface, clouds.scheme)
        for parts, station in zip(above.slices, at, strict=True)
    ]
    road = planes.height + ground.base
    sight = sight_table(signs, path, road, joined(above.hides or [_NOTHING]), clouds.scheme.classes)
    sections = section_medians(table, _sections(inventory, found))
    places = road_places(table, path, least_clearance=CLEARANCE if envelope is None else envelope[1])
    return MeasuredRoad(table, sections, path, across, inventory.crs, sight, places)


class _Above(NamedTuple):
    """Lowest points over the road and in an envelope, and points of sections, from one reading of all points."""

    over: Lowest
    inside: Lowest
    envelope: tuple[float, float] | None
    at: Sequence[float]
    slices: list[list[pd.DataFrame]]  # By section
    hides: list[Standing] | None  # What may hide a sign; None without signs

    @classmethod
    def empty(
        cls, stations: int, envelope: tuple[float, float] | None, at: Sequence[float], *, hides: bool
    ) -> "_Above":
        inside = Lowest.empty(0 if envelope is None else stations)
        return cls(Lowest.empty(stations), inside, envelope, at, [[] for _ in at], [] if hides else None)

    def read(self, clouds: _Clouds, path: RoadPath, ground: Ground, planes: Planes, lane: NDArray[np.float64]) -> None:
        """Read all points; `lane` are the offsets between which points are over the road, shape (2, stations)."""
        fixed, surface = clouds.roles()[2], surface_heights(ground, planes)
        for points in clouds.chunks():
            places = path.locate(points.xyz)
            for parts, station in zip(self.slices, self.at, strict=True):
                parts.append(_slice(points, places, station))
            places = _of_rows(places, fixed[points.label[places.row]])
            height = above_road(places, points.xyz[places.row, 2] - ground.base, surface, planes)
            row = (places.station / STEP).astype(np.int64)
            over = (height >= LOWEST) & (height < HIGHEST)
            over &= (places.offset > lane[0, row]) & (places.offset < lane[1, row])
            _add(self.over, points, places, height, over)
            if self.envelope is not None:
                width, top = self.envelope
                near = (height >= FROM) & (height < top) & (np.abs(places.offset) < width / 2)
                _add(self.inside, points, places, height, near)
            if self.hides is not None:
                own = np.unique(places.row[may_hide(height)])
                self.hides.append(standing(points.xyz[own], points.label[own]))


def _sections(inventory: RoadInventory, found: Trajectory) -> pd.DataFrame:
    """Return the sections of the inventory, or sections of 100 m with the objects in them along another path."""
    if inventory.sections is not None and found is inventory.trajectory:
        return inventory.sections
    objects = inventory.objects[["kind", "x", "y", "z"]]
    station, offset = found.locate(objects[["x", "y", "z"]].to_numpy(dtype=np.float64))
    near = (station >= 0) & (station <= found.length)
    return section_table(
        objects.assign(station=station, offset=offset)[near], found.length, sections=equal_sections(found.length)
    )


def _axis_of_ground(clouds: _Clouds) -> Trajectory:
    """Return the main axis of the ground as a path, which holds for straight roads alone."""
    ground = clouds.roles()[0]
    parts = [points.xyz[ground[points.label]][::_SAMPLED] for points in clouds.chunks()]
    xyz = np.concatenate(parts)
    if len(xyz) < 2:
        raise DataError(f"{clouds.output.path} has no ground")
    axis: MainAxis = main_axis(xyz)
    station, _ = axis.locate(xyz)
    ends = axis.centre + np.outer([station.min(), station.max()], axis.direction)
    logger.warning(
        "The survey has no path: stations are along the main axis of its ground, which is right for a straight road "
        "alone; name a path with --path"
    )
    return Trajectory.from_positions(np.column_stack([ends, np.full(2, np.median(xyz[:, 2]))]), source="main axis")


def _read_ground(clouds: _Clouds, path: RoadPath) -> Ground:
    is_ground, natural, _ = clouds.roles()
    ground = Ground.empty(len(path), float(path.xyz[0, 2]))
    for points in clouds.chunks():
        rows = np.flatnonzero(is_ground[points.label])
        places = path.locate(points.xyz[rows])
        own = rows[places.row]
        ground.add(places, points.xyz[own, 2], natural[points.label[own]])
    return ground


def _of_rows(places: Located, kept: NDArray[np.bool_]) -> Located:
    return Located(places.row[kept], places.station[kept], places.offset[kept])


def _add(
    lowest: Lowest, points: _Points, places: Located, height: NDArray[np.float64], kept: NDArray[np.bool_]
) -> None:
    own = _of_rows(places, kept)
    lowest.add(own, height[kept], points.label[own.row], points.number[own.row])


def _slice(points: _Points, places: Located, station: float) -> pd.DataFrame:
    """Return the points beside a station."""
    near = _of_rows(places, np.abs(places.station - station) <= SLICE)
    columns = dict(zip("xyz", points.xyz[near.row].T, strict=True))
    columns |= {"station": near.station, "offset": near.offset}
    return pd.DataFrame({**columns, "label": points.label[near.row], "object_id": points.number[near.row]})


def _cross_section(
    station: float, parts: Sequence[pd.DataFrame], table: pd.DataFrame,
    surface: NDArray[np.float64], scheme: ClassScheme,
) -> CrossSection:  # fmt: skip
    points = pd.concat(parts, ignore_index=True)
    names = np.array([*scheme.classes, *[""] * (256 - len(scheme))], dtype=object)
    points = points.assign(**{"class": names[points["label"]]}).drop(columns="label")
    row = min(int(station / STEP), len(table) - 1)
    offset = (np.arange(CELLS) + 0.5) * CELL - CELLS * CELL / 2
    low, high = (float(table[f"{side}_offset"].iloc[row]) for side in ("left", "right"))
    within = (offset >= (low if np.isfinite(low) else -BESIDE)) & (offset <= (high if np.isfinite(high) else BESIDE))
    profile = np.column_stack([offset, surface[row]])[within]
    return CrossSection(float(station), points, profile[np.isfinite(profile[:, 1])], table.iloc[row])

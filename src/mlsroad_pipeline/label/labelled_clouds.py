"""Labelled clouds of a survey: points with the positions of the scanner, and what its rays say about places."""

import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.core.codings import NOISE_CODES
from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.inventory.lines.kerbs.kerb_lines import ground_classes
from mlsroad_pipeline.algorithms.inventory.objects.candidate_table import candidate_rules
from mlsroad_pipeline.algorithms.inventory.objects.class_groups import GROUPS, group_shares
from mlsroad_pipeline.algorithms.inventory.objects.rules import KINDS
from mlsroad_pipeline.algorithms.inventory.objects.table import new_keys
from mlsroad_pipeline.algorithms.inventory.register.seen_space import (
    FURNITURE,
    LOW_VEGETATION,
    NO_KIND,
    SeenSpace,
    add_rays,
    index_places,
)
from mlsroad_pipeline.algorithms.scenes.trajectory import Trajectory
from mlsroad_pipeline.formats.las.header import class_names, read_header
from mlsroad_pipeline.formats.registry import get_format
from mlsroad_pipeline.inventory_files.road_inventory import RoadInventory
from mlsroad_pipeline.review.corrections.labelled_output import LabelledOutput
from mlsroad_pipeline.surveys.given_classes import GivenParameters
from mlsroad_pipeline.surveys.reading import options_in_use
from mlsroad_pipeline.surveys.register_files import KINDS as COMPARED
from mlsroad_pipeline.surveys.trajectory_files import in_weeks_of, read_trajectory

logger = logging.getLogger(__name__)

CHUNK = 2_000_000
"""Points that are read at once."""
GROUND_REACH = 2.0
"""Distance in plan up to which ground points give the height of the ground at a place, metres."""
_FURNITURE = ("bus_shelter", "bin", "bench", "bollard", "hydrant", "mail_box", "parking_meter", "other_object")
_FEET = 25  # ground points that are kept for each place


@dataclass(frozen=True)
class LabelledCloud:
    """A labelled cloud, its trajectory, and the meaning of its codes."""

    path: Path
    trajectory: Trajectory | None  # Where rays begin; None: points alone are counted
    output: LabelledOutput
    is_ground: NDArray[np.bool_]  # By class code
    kind: NDArray[np.uint8]  # Number of the kind of each class code, or `NO_KIND`
    label: NDArray[np.int16]  # Class of each code in the scheme, -1 for none
    scheme: ClassScheme
    move: Callable[[NDArray[np.float64]], NDArray[np.float64]] | None = None  # Puts the cloud into another place

    def chunks(self) -> Iterator[Any]:
        """Yield world coordinates, codes and the positions of the scanner of a part of the points."""
        form, options = get_format(self.path), self.output.read_options()
        info = form.info(self.path, options)
        names = tuple(name for name in ("classification", "gps_time") if name in info.columns)
        for start in range(0, info.n_points, CHUNK):
            cloud = form.read(self.path, replace(options, only=names), start=start, stop=start + CHUNK)
            cloud = cloud.select(~np.isin(cloud["classification"], NOISE_CODES))
            xyz = cloud.world_xyz()
            path = self.trajectory  # a ray without length crosses nothing
            scanner = xyz if path is None else scanner_positions(path, xyz, cloud.get("gps_time"))
            if self.move is not None:
                xyz, scanner = self.move(xyz), self.move(scanner)
            yield xyz, cloud["classification"].astype(np.uint8), scanner

    def near(
        self, places: NDArray[np.float64], reach: float
    ) -> tuple[NDArray[np.float64], NDArray[np.uint8], NDArray[np.float32]]:
        """Return coordinates, codes and intensities (NaN: none) of the points near places in plan."""
        form, options = get_format(self.path), self.output.read_options()
        info, tree = form.info(self.path, options), cKDTree(places[:, :2])
        names = tuple(name for name in ("classification", "intensity") if name in info.columns)
        parts = [(np.zeros((0, 3)), np.zeros(0, np.uint8), np.zeros(0, np.float32))]
        for start in range(0, info.n_points, CHUNK):
            cloud = form.read(self.path, replace(options, only=names), start=start, stop=start + CHUNK)
            xyz = cloud.world_xyz() if self.move is None else self.move(cloud.world_xyz())
            rows = np.flatnonzero(np.isfinite(tree.query(xyz[:, :2], distance_upper_bound=reach)[0]))
            code = cloud["classification"][rows].astype(np.uint8)
            bright = cloud["intensity"][rows] if "intensity" in cloud else np.full(len(rows), np.nan, np.float32)
            kept = ~np.isin(code, NOISE_CODES)
            parts.append((xyz[rows[kept]], code[kept], bright[kept]))
        xyz, code, bright = (np.concatenate(column) for column in zip(*parts, strict=True))
        return xyz, code, bright

    def points_of(self, numbers: NDArray[np.int64]) -> Iterator[tuple[NDArray[np.float64], NDArray[np.int64]]]:
        """Yield the points of some objects, each with the row of its object in `numbers`."""
        form, options = get_format(self.path), self.output.read_options()
        info, order = form.info(self.path, options), np.argsort(numbers)
        for start in range(0, info.n_points, CHUNK):
            cloud = form.read(self.path, replace(options, only=("object_id",)), start=start, stop=start + CHUNK)
            own = np.flatnonzero(np.isin(cloud["object_id"], numbers))
            row = order[np.searchsorted(numbers, cloud["object_id"][own], sorter=order)]
            xyz = cloud.world_xyz()[own]
            yield xyz if self.move is None else self.move(xyz), row


def scanner_positions(
    trajectory: Trajectory, xyz: NDArray[np.float64], time: NDArray[np.float64] | None
) -> NDArray[np.float64]:
    """Return the position of the trajectory at each point: at its time, or the nearest one without times."""
    if trajectory.time is not None and time is not None and len(time):
        path = in_weeks_of(trajectory, float(time.min()), float(time.max()))
        clock = np.asarray(path.time)
        if ((time >= clock[0]) & (time <= clock[-1])).mean() > 0.5:
            return np.column_stack([np.interp(time, clock, axis) for axis in path.xyz.T])
    _, row = cKDTree(trajectory.xyz[:, :2]).query(xyz[:, :2])
    nearest: NDArray[np.float64] = trajectory.xyz[row]
    return nearest


def labelled_clouds(output: LabelledOutput, inventory: RoadInventory) -> list[LabelledCloud]:
    """Return the labelled clouds with their trajectories; DataError where there is none."""
    files = output.clouds()
    paths = trajectories_of(output, inventory)
    found = []
    for name, path in files.items():
        scheme = output.model_scheme(class_names(read_header(path)))
        if scheme is None:
            raise DataError(
                f"{path}: the scheme of its model is not configured (classes.schemes), so its codes have no meaning"
            )
        trajectory = _of_folder(PurePosixPath(name).parent.parts, paths) or inventory.trajectory
        found.append(LabelledCloud(path, trajectory, output, *meaning_of_codes(output, scheme), scheme))
    without = [cloud.path for cloud in found if cloud.trajectory is None]
    if without:
        more = f" and {len(without) - 1} more files have" if len(without) > 1 else " has"
        logger.warning("%s%s no trajectory, from which rays begin: nothing there is found to be gone", without[0], more)
    return found


def _of_folder(folder: tuple[str, ...], paths: Mapping[Path, Trajectory]) -> Trajectory | None:
    """Return the trajectory of a folder of the survey, or the only one."""
    own = [found for path, found in paths.items() if path.parent.parts[-len(folder) or None :] == folder]
    return (own or [*paths.values()])[0] if own or len(paths) == 1 else None


def trajectories_of(output: LabelledOutput, inventory: RoadInventory) -> dict[Path, Trajectory]:
    """Return the trajectories of the survey in metres; those that are gone are left out."""
    named = Path(str(output.record["settings"]["label"].get("trajectory") or "")).name
    inputs = dict.fromkeys(Path(entry["path"]) for entry in output.record.get("inputs", ()))
    paths = [path for path in inputs if path.name == named]
    missing = [path for path in paths if not path.is_file()]
    if inventory.trajectory is not None and (missing or not paths):
        what = f"{missing[0]} is missing" if missing else "The survey has no file of a trajectory"
        logger.warning("%s: rays begin at the nearest place of the path of the inventory", what)
    cloud = next(iter(output.clouds().values()))
    factors = options_in_use(get_format(cloud), str(cloud), output.read_options()).factors
    return {path: read_trajectory(path, crs=inventory.crs, factors=factors) for path in paths if path.is_file()}


def kept_codes(output: LabelledOutput, scheme: ClassScheme) -> dict[int, int]:
    """Return the class of each code that points of the survey kept, beside the codes of the scheme itself."""
    settings = output.record["settings"]
    given = GivenParameters.from_config(settings["label"].get("given") or {})
    kept = given.kept_legend(scheme, (settings.get("classes") or {}).get("codings") or {})
    own = set(scheme.codes(output.written_scheme).tolist())
    pairs = () if kept is None else zip(kept.numbers, kept.labels(scheme).tolist(), strict=True)
    return {number: label for number, label in pairs if label >= 0 and number < 256 and number not in own}


def meaning_of_codes(
    output: LabelledOutput, scheme: ClassScheme
) -> tuple[NDArray[np.bool_], NDArray[np.uint8], NDArray[np.int16]]:
    """Return which class codes are ground, the number of the kind of each, and its class or -1."""
    codes = scheme.codes(output.written_scheme)
    is_ground, kind = np.zeros(256, dtype=np.bool_), np.full(256, NO_KIND, dtype=np.uint8)
    label = np.full(256, -1, dtype=np.int16)
    is_ground[codes[ground_classes(scheme)]], label[codes] = True, np.arange(len(scheme))
    for name, rule in candidate_rules(scheme, {}).items():
        if rule.kind in COMPARED:
            kind[codes[scheme.classes.index(name)]] = KINDS.index(rule.kind)
    furniture = [any(member in _FURNITURE for member in members) for members in scheme.members]
    kind[codes[furniture]] = FURNITURE
    kind[codes[group_shares(scheme)[:, GROUPS.index("low vegetation")] > 0.5]] = LOW_VEGETATION
    for number, own in kept_codes(output, scheme).items():
        is_ground[number], kind[number], label[number] = is_ground[codes[own]], kind[codes[own]], own
    return is_ground, kind, label


def seen_space(places: NDArray[np.float64], kind: NDArray[np.str_], clouds: Sequence[LabelledCloud]) -> SeenSpace:
    """Return what the rays of all clouds say about places on the ground."""
    seen = SeenSpace.unseen(len(places))
    if not len(places):
        return seen
    index, number = index_places(places), np.array([KINDS.index(name) for name in kind], dtype=np.uint8)
    for cloud in clouds:
        for xyz, code, scanner in cloud.chunks():
            add_rays(seen, index, number, scanner, xyz, cloud.kind[code])
    return seen


def on_ground(xy: NDArray[np.float64], clouds: Sequence[LabelledCloud]) -> NDArray[np.float64]:
    """Return places with the median height of their nearest ground points; NaN without one within `GROUND_REACH`."""
    rows, heights = [np.zeros(0, np.int64)], [np.zeros(0)]
    for cloud in clouds if len(xy) else ():
        for xyz, code, _ in cloud.chunks():
            ground = xyz[cloud.is_ground[code]]
            if not len(ground):
                continue
            distance, near = cKDTree(ground[:, :2]).query(xy, k=_FEET, distance_upper_bound=GROUND_REACH)
            known = np.isfinite(distance)
            rows.append(np.nonzero(known)[0])
            heights.append(ground[near[known], 2])
    median = pd.Series(np.concatenate(heights)).groupby(np.concatenate(rows)).median()
    return np.column_stack([xy, median.reindex(np.arange(len(xy)))])


class Recorded(NamedTuple):
    """A labelled survey: its corrected inventory and its clouds."""

    output: LabelledOutput
    inventory: RoadInventory
    clouds: list[LabelledCloud]

    @classmethod
    def of(cls, output: LabelledOutput, inventory: RoadInventory) -> "Recorded":
        """Return a survey with the inventory that is compared; objects of earlier versions get their keys."""
        table = inventory.objects
        inventory = replace(inventory, objects=table.assign(key=new_keys(table, crs=inventory.crs)))
        return cls(output, inventory, labelled_clouds(output, inventory))

    @property
    def objects(self) -> pd.DataFrame:
        """Poles, signs and trees."""
        table = self.inventory.objects
        return table[table["kind"].isin(COMPARED)].reset_index(drop=True)

    @property
    def path(self) -> NDArray[np.float64] | None:
        """Positions of the scanner."""
        paths = [cloud.trajectory.xyz for cloud in self.clouds if cloud.trajectory is not None]
        return np.concatenate(list({id(path): path for path in paths}.values())) if paths else None

    def moved(self, move: Callable[[NDArray[np.float64]], NDArray[np.float64]]) -> "Recorded":
        """Return the survey in another place; lines stay."""
        table = self.inventory.objects
        places = move(table[["x", "y", "z"]].to_numpy(dtype=np.float64))
        table = table.assign(**{axis: places[:, k] for k, axis in enumerate("xyz")})
        clouds = [replace(cloud, move=move) for cloud in self.clouds]
        return self._replace(inventory=replace(self.inventory, objects=table), clouds=clouds)

    def class_chunks(self) -> Iterator[tuple[NDArray[np.float64], NDArray[np.int16]]]:
        """Yield the points with their classes, -1 for none."""
        for cloud in self.clouds:
            for xyz, code, _ in cloud.chunks():
                yield xyz, cloud.label[code]

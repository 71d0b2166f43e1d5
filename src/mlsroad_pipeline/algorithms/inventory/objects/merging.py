"""Merging of objects across scenes in bounded memory.

The scenes are read twice. The first pass links fragments that share a voxel, directly or through others. The second
pass sums voxels scene by scene and measures an object after its last scene. Memory holds the indices of all voxels and
the objects that are still open.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.geometry.cells import order_of_cells
from mlsroad_pipeline.algorithms.geometry.graphs import connected_components
from mlsroad_pipeline.algorithms.inventory.objects.extraction import SceneObjects
from mlsroad_pipeline.algorithms.inventory.objects.fragments import join_voxels
from mlsroad_pipeline.algorithms.inventory.objects.measured_rows import Evidence, measured_rows
from mlsroad_pipeline.algorithms.inventory.objects.object_classifier import Classifier
from mlsroad_pipeline.algorithms.inventory.objects.rules import ObjectRule
from mlsroad_pipeline.algorithms.inventory.objects.table import OBJECT_FIELDS, empty_table, finish_table, object_table
from mlsroad_pipeline.algorithms.scenes.trajectory import Trajectory

BATCH = 1 << 18
"""Number of voxels collected before objects are measured."""


class MergedObjects(NamedTuple):
    """Inventory of a survey, and the numbers of its objects in each scene."""

    objects: pd.DataFrame  # Columns of `OBJECT_FIELDS`
    # Scene to its `object_id` by `SceneObjects.part`: ``numbers[scene][part]`` numbers the points, 0 for none
    numbers: dict[str, NDArray[np.uint32]]


class _Numbers:
    """Provisional numbers of the objects of all scenes, in the order in which they are measured."""

    def __init__(self) -> None:
        self.tables: list[pd.DataFrame] = []
        self.scenes: list[NDArray[np.uint32]] = []
        self.n_objects = 0

    def open_scene(self, piece: SceneObjects) -> None:
        """Add the next scene with the objects that lie wholly in it."""
        number = np.zeros(1 + len(piece.objects) + len(piece.fragments), dtype=np.uint32)
        number[1 : 1 + len(piece.objects)] = self.n_objects + 1 + np.arange(len(piece.objects))
        self.scenes.append(number)
        self._append(piece.objects)

    def add(self, table: pd.DataFrame, scene: NDArray[np.int64], row: NDArray[np.int64], owner: NDArray) -> None:
        """Add merged objects; `owner` is the object of row `row` of the fragments of a scene, -1 for none."""
        number = np.where(owner < 0, 0, self.n_objects + 1 + owner)
        for i in np.unique(scene):
            mine = scene == i
            self.scenes[i][-1 - row[mine]] = number[mine]  # rows count from the end: see `SceneObjects.part`
        self._append(table)

    def _append(self, table: pd.DataFrame) -> None:
        if len(table):
            self.tables.append(table)
        self.n_objects += len(table)

    def joined(self) -> pd.DataFrame:
        """Return all objects; their `object_id` is the provisional number."""
        table = pd.concat(self.tables, ignore_index=True) if self.tables else empty_table(OBJECT_FIELDS)
        return table.assign(object_id=np.arange(1, len(table) + 1))

    def final(self, provisional: NDArray[np.integer], final: NDArray[np.integer]) -> list[NDArray[np.uint32]]:
        """Return the numbers of each scene in the inventory; objects without a final number get 0."""
        renumbered = np.zeros(self.n_objects + 1, dtype=np.uint32)
        renumbered[provisional] = final
        return [renumbered[number] for number in self.scenes]


@dataclass
class _Links:
    """Voxels of the fragments of one class, and their connected components."""

    corner: NDArray[np.int64] | None = None
    voxels: list[NDArray[np.int32]] = field(default_factory=list)
    fragment: list[NDArray[np.int32]] = field(default_factory=list)
    scene: list[NDArray[np.int32]] = field(default_factory=list)
    starts: dict[int, int] = field(default_factory=dict)
    n_fragments: int = 0

    def add(self, i: int, scene: str, table: pd.DataFrame) -> None:
        """Add the fragments of the i-th scene."""
        numbers, fragment = np.unique(table["fragment"].to_numpy(), return_inverse=True)
        key = table[["i", "j", "k"]].to_numpy()
        if self.corner is None:  # relative indices fit into four bytes
            self.corner = key[0]
        offset = key - self.corner
        if np.abs(offset).max() > np.iinfo(np.int32).max:
            raise DataError(f"scene {scene!r}: voxels lie {np.abs(offset).max():,} voxels from those of another scene")
        self.voxels.append(offset.astype(np.int32))
        self.fragment.append((fragment + self.n_fragments).astype(np.int32))
        self.scene.append(np.full(len(numbers), i, dtype=np.int32))
        self.starts[i] = self.n_fragments
        self.n_fragments += len(numbers)

    def join(self) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
        """Return the object of each fragment and the last scene of each object; the voxels are released."""
        voxel, fragment = np.concatenate(self.voxels), np.concatenate(self.fragment)
        self.voxels, self.fragment = [], []
        order = order_of_cells(voxel)
        same = np.ones(len(order) - 1, dtype=bool)
        for axis in range(3):
            same &= np.diff(voxel[order, axis]) == 0
        sharing = fragment[order]
        edges = np.column_stack([sharing[:-1], sharing[1:]])[same]
        number = connected_components(edges, n_nodes=self.n_fragments)
        last = np.zeros(int(number.max()) + 1, dtype=np.int32)
        np.maximum.at(last, number, np.concatenate(self.scene))
        return number, last


def _by_class(piece: SceneObjects) -> Iterator[tuple[str, pd.DataFrame, pd.DataFrame]]:
    """Yield the fragments of a scene and their evidence class by class."""
    for name, table in piece.fragments.groupby("class", sort=False):
        evidence = piece.evidence[piece.evidence["class"] == name]
        yield str(name), table.drop(columns="class"), evidence.drop(columns="class")


def _link(pieces: Sequence[SceneObjects], classes: Mapping[str, ObjectRule]) -> tuple[list[str], dict[str, _Links]]:
    """Read the scenes for the first time: their names, and which fragments share voxels."""
    scenes: list[str] = []
    links: dict[str, _Links] = {}
    for i, piece in enumerate(pieces):
        if piece.scene in scenes:
            raise DataError(f"scene {piece.scene!r} comes twice")
        scenes.append(piece.scene)
        named = {*piece.objects["class"].unique(), *piece.fragments["class"].unique()}  # a fragment has many rows
        if named - set(classes):
            raise DataError(f"objects of class {min(named - set(classes))!r}, which has no rule: {sorted(classes)}")
        for name, table, _ in _by_class(piece):
            links.setdefault(name, _Links()).add(i, piece.scene, table)
    return scenes, links


class _Joiner:
    """Accumulator of the voxels of one class; measures each object once it is complete."""

    def __init__(
        self,
        name: str,
        classes: Mapping[str, ObjectRule],
        links: _Links,
        scenes: Sequence[str],
        classifier: Classifier | None,
    ) -> None:
        self.name, self.classes, self.classifier = name, classes, classifier
        self.ordered = sorted(scenes)
        rank = {scene: i for i, scene in enumerate(self.ordered)}
        self.rank = [rank[scene] for scene in scenes]
        self.starts = links.starts
        self.number, self.last = links.join()
        self.open: list[pd.DataFrame] = []
        self.evidence: list[pd.DataFrame] = []
        self.n_open, self.enough = 0, BATCH

    def add(self, i: int, table: pd.DataFrame, evidence: pd.DataFrame, numbers: _Numbers) -> None:
        """Add the fragments of the i-th scene; number the complete objects once enough voxels are collected."""
        names, fragment = np.unique(table["fragment"].to_numpy(), return_inverse=True)
        number = self.number[fragment + self.starts[i]].astype(np.int64)
        if len(evidence):
            rank = np.searchsorted(names, evidence["fragment"].to_numpy())
            self.evidence.append(evidence.assign(object=self.number[rank + self.starts[i]].astype(np.int64)))
        self.open.append(table.assign(object=number, scene=self.rank[i], piece=i, row=table.index))
        self.n_open += len(table)
        if self.n_open >= self.enough:
            self.measure(i, numbers)

    def measure(self, i: int, numbers: _Numbers) -> None:
        """Measure and number the objects whose last scene is the i-th or an earlier one."""
        if not self.open:
            return
        table = pd.concat(self.open, ignore_index=True)
        done = self.last[table["object"].to_numpy()] <= i
        self.open = [table[~done]] if not done.all() else []
        self.n_open = len(table) - int(done.sum())
        self.enough = max(BATCH, 2 * self.n_open)  # avoids repeated copies of a large open object
        if not done.any():
            return
        voxels, number, joined = join_voxels(table[done], resolution=self.classes[self.name].resolution)
        known = self._complete_evidence(i)
        rows, owner = measured_rows(
            *(voxels, number, self.name, self.classes, self.ordered), evidence=known, classifier=self.classifier
        )
        own = np.append(owner, -1)[joined]  # voxels without points are of no object
        numbers.add(object_table(rows), table["piece"].to_numpy()[done], table["row"].to_numpy()[done], own)

    def _complete_evidence(self, i: int) -> Evidence | None:
        """Return the evidence of the objects whose last scene is the i-th or an earlier one; None without evidence."""
        if not self.evidence:
            return None
        table = pd.concat(self.evidence, ignore_index=True)
        done = self.last[table["object"].to_numpy()] <= i
        self.evidence = [table[~done]] if not done.all() else []
        return Evidence(table[done])


def _without_pieces(listed: pd.DataFrame) -> pd.DataFrame:
    """Return objects without vehicles with an assumed box whose middle lies in the box of one with more points.

    The other one is at least half as probable.
    """
    rows = np.flatnonzero(listed["kind"] == "vehicle")
    if len(rows) < 2:
        return listed
    table = listed.iloc[rows]
    turn = np.radians(table["heading"].to_numpy(np.float64))
    where = table[["x", "y"]].to_numpy(np.float64)
    near = cKDTree(where).query_pairs(float(table["length"].max()), output_type="ndarray")
    pairs = np.concatenate([near, near[:, ::-1]])  # (the piece, the whole)
    off = where[pairs[:, 0]] - where[pairs[:, 1]]
    sine, cosine = np.sin(turn[pairs[:, 1]]), np.cos(turn[pairs[:, 1]])
    along, across = off[:, 0] * sine + off[:, 1] * cosine, off[:, 0] * cosine - off[:, 1] * sine
    half = table[["length", "width"]].to_numpy(np.float64)[pairs[:, 1]] / 2
    number, score = table["point_count"].to_numpy(), table["score"].to_numpy(np.float64)
    within = (np.abs(along) < half[:, 0]) & (np.abs(across) < half[:, 1])
    within &= (number[pairs[:, 0]] < number[pairs[:, 1]]) & (score[pairs[:, 0]] <= 2 * score[pairs[:, 1]])
    within &= (table["complete"] != "measured").to_numpy()[pairs[:, 0]]
    return listed.drop(table.index[np.unique(pairs[within, 0])])


def merge_across_scenes(
    pieces: Sequence[SceneObjects], *, classes: Mapping[str, ObjectRule], trajectory: Trajectory | None = None
) -> pd.DataFrame:
    """Return the inventory of a survey: the objects of `merge_scenes` without the numbers of the points."""
    return merge_scenes(pieces, classes=classes, trajectory=trajectory).objects


def merge_scenes(
    pieces: Sequence[SceneObjects],
    *,
    classes: Mapping[str, ObjectRule],
    trajectory: Trajectory | None = None,
    classifier: Classifier | None = None,
    least_score: Mapping[str, float] | float = 0.0,
    within: float | None = None,
) -> MergedObjects:
    """Merge the objects of all scenes into the inventory of a survey, without those farther from the path.

    Fragments that share a voxel, directly or through others, are merged, then measured and filtered as one object. An
    object belongs to the scene whose core contains its foot.
    """
    scenes, links = _link(pieces, classes)
    joiners = {name: _Joiner(name, classes, links.pop(name), scenes, classifier) for name in list(links)}
    numbers = _Numbers()
    for i, piece in enumerate(pieces):
        numbers.open_scene(piece)
        for name, table, evidence in _by_class(piece):
            joiners[name].add(i, table, evidence, numbers)
    for joiner in joiners.values():
        joiner.measure(len(scenes), numbers)
    listed = numbers.joined()
    least = listed["kind"].map(least_score).astype(np.float64) if isinstance(least_score, Mapping) else least_score
    listed = _without_pieces(listed[listed["score"] >= least])
    if within is not None and trajectory is not None and len(listed):
        listed = listed[trajectory.distance(listed[["x", "y", "z"]].to_numpy(np.float64)) <= within]
    objects, provisional = finish_table(listed, list(classes), trajectory)
    final = numbers.final(provisional, objects["object_id"].to_numpy())
    return MergedObjects(objects, dict(zip(scenes, final, strict=True)))

"""Tiles of a labelled cloud and candidate objects that corrections are about."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.stage_parameters import GroundParameters
from mlsroad_pipeline.algorithms.features.voxel_scales import VoxelFeatures
from mlsroad_pipeline.algorithms.inventory.objects.candidate_table import (
    FEATURE_COLUMNS,
    CandidateScene,
    find_candidate_table,
)
from mlsroad_pipeline.algorithms.inventory.objects.class_groups import evidence_of_soft_labels
from mlsroad_pipeline.algorithms.inventory.objects.object_classifier import LabelledCandidates
from mlsroad_pipeline.algorithms.inventory.objects.rules import KINDS, ObjectRule
from mlsroad_pipeline.algorithms.inventory.scoring.object_scores import REACH
from mlsroad_pipeline.algorithms.models.boosted_trees.labeller import describe_scene
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle, bundle_scheme
from mlsroad_pipeline.algorithms.models.labelling import label_softly
from mlsroad_pipeline.algorithms.stages import find_ground
from mlsroad_pipeline.model_store.object_classifiers import classifier_of
from mlsroad_pipeline.review.corrections.answers import NamedClasses
from mlsroad_pipeline.review.corrections.decisions import Decision
from mlsroad_pipeline.review.corrections.states import ObjectState

TILE, MARGIN = 30.0, 15.0
"""Edge of the tiles that are learned from, and width of the surroundings that are read with them, metres."""

_NOISE = 7


@dataclass(frozen=True)
class Tile:
    """A tile with its surroundings."""

    cell: tuple[int, int]  # Column and row in the grid of the cloud
    rows: NDArray[np.int64]  # Points of the cloud; noise is left out
    core: NDArray[np.bool_]  # Points in the tile itself
    ground: NDArray[np.bool_]  # Points of the ground
    height: NDArray[np.float32]  # Heights above the ground, metres
    voxels: VoxelFeatures  # Features of the voxels, and the voxel of each point
    scene: PointCloud  # The points with their intensity and colour


class TileGrid:
    """Square tiles of a cloud, from its lower left corner."""

    def __init__(self, cloud: PointCloud) -> None:
        self._cloud = cloud
        self._xy = cloud.xyz[:, :2]
        self._corner = self._xy.min(axis=0) if len(self._xy) else np.zeros(2)
        self.cell = np.floor((self._xy - self._corner) / TILE).astype(np.int64)

    def cell_of(self, xy: ArrayLike) -> NDArray[np.int64]:
        """Return the cells of places in world coordinates, shape (n, 2)."""
        local = np.asarray(xy, np.float64).reshape(-1, 2) - self._cloud.origin[:2]
        return np.floor((local - self._corner) / TILE).astype(np.int64)

    def described(self, cells: NDArray[np.int64], *, ground: GroundParameters, voxel_size: float) -> Iterator[Tile]:
        """Yield the tiles of cells, each once; tiles without points are left out."""
        cloud, xy = self._cloud, self._xy
        usable = np.ones(len(cloud), np.bool_) if "classification" not in cloud else cloud["classification"] != _NOISE
        for place in np.unique(cells, axis=0):
            low = self._corner + place * TILE
            near = (xy >= low - MARGIN).all(axis=1) & (xy < low + TILE + MARGIN).all(axis=1)
            rows = np.flatnonzero(usable & near)
            core = (self.cell[rows] == place).all(axis=1)
            if core.any():
                yield _described((int(place[0]), int(place[1])), cloud.select(rows), rows, core, ground, voxel_size)


def _described(
    cell: tuple[int, int],
    part: PointCloud,
    rows: NDArray[np.int64],
    core: NDArray[np.bool_],
    parameters: GroundParameters,
    voxel_size: float,
) -> Tile:
    plain = part.without_columns(set(part.columns) - {"intensity", "rgb", "classification", "confidence"})
    ground = find_ground(plain, parameters)
    found = describe_scene(plain, ground, voxel_size=voxel_size)
    return Tile(cell, rows, core, ground["ground"], ground["height"], found, plain)


NOTHING = ""
"""Right kind of an object that is none."""

_DIVIDED = ("merged", "split")  # the candidate is a part of an object, or several
_LEAST_SHARE = 0.5  # of the points of an object and of its candidate that both have


class DecidedObject(NamedTuple):
    """An object of the inventory that a user has decided about."""

    kind: str  # Kind in the inventory
    # Kind that it is, `NOTHING` for none of them; None if it is only known that it is not of its kind
    right: str | None


class RatedCandidates(NamedTuple):
    """Candidates of a tile, and the answers about them."""

    candidates: pd.DataFrame  # Columns of `find_candidate_table`
    answers: list[tuple[int, bool]]  # Row of a candidate, and whether it is an object of its kind
    n_added: int = 0  # How many of the last answers are about added objects


def decided_objects(
    states: Mapping[int, ObjectState],
    kinds: Mapping[int, str],
    named: NamedClasses,
    rules: Mapping[str, ObjectRule],
) -> dict[int, DecidedObject]:
    """Return what the decisions say about whole objects; merged and split ones are left out."""
    found = {}
    for number, state in states.items():
        kind = kinds.get(number, NOTHING)
        if kind not in KINDS or state["status"] in _DIVIDED or "merged_into" in state:
            continue
        given = _kind_of_class(state["checked_class"], named, rules)
        if state["status"] == "rejected":
            found[number] = DecidedObject(kind, NOTHING if given == NOTHING else None)
        elif state["status"] == "changed":
            asked = state["checked_kind"] if state["checked_kind"] in KINDS else None
            found[number] = DecidedObject(kind, asked if given is None else given)
        else:
            found[number] = DecidedObject(kind, kind)
    return found


def _kind_of_class(name: str, named: NamedClasses, rules: Mapping[str, ObjectRule]) -> str | None:
    """Return the kind of the objects of a class; None without a class, or if its members differ."""
    if not name:
        return None
    members = [member for member, allowed in zip(named.scheme.classes, named.allowed(name), strict=True) if allowed]
    kinds = {rules[member].kind if member in rules else NOTHING for member in members}
    return kinds.pop() if len(kinds) == 1 else None


class TileObjects:
    """Decided and added objects of a file by the tile that they stand in."""

    def __init__(
        self,
        grid: TileGrid,
        object_id: NDArray[np.integer],
        decided: Mapping[int, DecidedObject],
        added: Sequence[Decision],
    ) -> None:
        self._object_id, self._decided = object_id, decided
        points = np.flatnonzero(np.isin(object_id, list(decided)))
        numbers, counts = np.unique(object_id[points], return_counts=True)
        self._n_points = dict(zip(numbers.tolist(), counts.tolist(), strict=True))
        table = pd.DataFrame(grid.cell[points], columns=["i", "j"]).assign(object=object_id[points])
        most = table.value_counts(sort=True).reset_index().drop_duplicates("object")
        self._cell = {int(o): (int(i), int(j)) for i, j, o in most[["i", "j", "object"]].itertuples(index=False)}
        places = [(d.correction.payload["x"], d.correction.payload["y"]) for d in added]
        self._added = list(zip(map(tuple, grid.cell_of(places).tolist()), added, strict=True))

    @property
    def cells(self) -> NDArray[np.int64]:
        """Tiles that an object stands in, shape (k, 2)."""
        cells = [*self._cell.values(), *(cell for cell, _ in self._added)]
        return np.array(cells, np.int64).reshape(-1, 2)

    def rated(self, tile: Tile, bundle: ModelBundle, rules: Mapping[str, ObjectRule]) -> list[RatedCandidates]:
        """Return the candidates of a tile with the answers about them; none for a tile without an object."""
        decided = {number: self._decided[number] for number, cell in self._cell.items() if cell == tile.cell}
        added = [decision for cell, decision in self._added if cell == tile.cell]
        if not decided and not added:
            return []
        found = _tile_candidates(tile, self._object_id[tile.rows], bundle, rules)
        rows, new = list(answered_candidates(found, decided, self._n_points)), list(added_candidates(found, added))
        return [RatedCandidates(found, [*rows, *new], len(new))] if rows or new else []


def _tile_candidates(
    tile: Tile, object_id: NDArray[np.integer], bundle: ModelBundle, rules: Mapping[str, ObjectRule]
) -> pd.DataFrame:
    soft = label_softly(bundle, tile.scene.with_columns(ground=tile.ground, height=tile.height))
    evidence = evidence_of_soft_labels(*soft, scheme=bundle_scheme(bundle))
    known = np.isfinite(tile.height)
    scene = CandidateScene(
        tile.scene.xyz.astype(np.float64),
        np.asarray(tile.scene.origin, np.float64),
        np.where(known, tile.height, 0.0).astype(np.float64),
        evidence,
        object_id,
    )
    return find_candidate_table(scene, rules, classifier_of(bundle))


def answered_candidates(
    candidates: pd.DataFrame, decided: Mapping[int, DecidedObject], n_points: Mapping[int, int]
) -> Iterator[tuple[int, bool]]:
    """Yield the rows of candidates that decisions are about, and whether each is an object of its kind."""
    for number, decision in decided.items():
        own = candidates[candidates["instance"] == number]
        own = own[own["shared"] >= _LEAST_SHARE * np.maximum(own["point_count"], n_points[number])]
        if not len(own):
            continue
        best = own.sort_values("shared", ascending=False, kind="stable").iloc[0]
        same = own[(own["own_kind"] == best["own_kind"]) & (own["part"] == best["part"])]
        for row, kind in zip(same.index.tolist(), same["kind"].tolist(), strict=True):
            if decision.right is not None:
                yield row, kind == decision.right
            elif kind == decision.kind:
                yield row, False


def added_candidates(candidates: pd.DataFrame, added: Iterable[Decision]) -> Iterator[tuple[int, bool]]:
    """Yield the nearest candidate of each missing object that a user has added, within the distance of a right one."""
    where = candidates[["x", "y"]].to_numpy(np.float64)
    for decision in added:
        kind, given = decision.correction.kind, decision.correction.payload
        rows = np.flatnonzero(candidates["kind"].to_numpy() == kind)
        gap = np.hypot(*(where[rows] - (given["x"], given["y"])).T)
        if kind in REACH and len(rows) and gap.min() <= REACH[kind]:
            yield int(rows[gap.argmin()]), True


def joined_answers(parts: Sequence[RatedCandidates]) -> dict[str, LabelledCandidates]:
    """Return the candidates that answers are about, by kind."""
    tables = [
        part.candidates.loc[[row for row, _ in part.answers], ["kind", *FEATURE_COLUMNS]].assign(
            true=[true for _, true in part.answers]
        )
        for part in parts
    ]
    if not tables:
        return {}
    table = pd.concat(tables, ignore_index=True)
    return {
        str(kind): LabelledCandidates(own[list(FEATURE_COLUMNS)].to_numpy(np.float32), own["true"].to_numpy(np.bool_))
        for kind, own in table.groupby("kind")
    }

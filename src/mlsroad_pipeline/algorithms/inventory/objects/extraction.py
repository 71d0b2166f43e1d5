"""Extraction of road objects from labelled points, consistent across scene borders.

`extract_objects` clusters the points of a scene's core and buffers. Objects wholly in the core are measured. Of objects
that extend into a buffer only the voxels of core points are kept; `merging.merge_across_scenes` merges them by shared
voxels and measures the whole. Cores are disjoint, so no point counts twice and objects may span any number of scenes.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.validation import check_column, check_xyz
from mlsroad_pipeline.algorithms.inventory.objects.candidate_table import forming_labels
from mlsroad_pipeline.algorithms.inventory.objects.class_groups import ClassEvidence
from mlsroad_pipeline.algorithms.inventory.objects.evidence import EVIDENCE_FIELDS, SceneCells
from mlsroad_pipeline.algorithms.inventory.objects.fragments import FRAGMENT_FIELDS, find_fragments, join_voxels
from mlsroad_pipeline.algorithms.inventory.objects.measured_rows import Evidence, measured_rows
from mlsroad_pipeline.algorithms.inventory.objects.measures import ObjectMeasures, measure
from mlsroad_pipeline.algorithms.inventory.objects.object_classifier import Classifier
from mlsroad_pipeline.algorithms.inventory.objects.rules import ObjectRule
from mlsroad_pipeline.algorithms.inventory.objects.table import empty_table, object_table
from mlsroad_pipeline.algorithms.inventory.objects.voxel_sums import voxelise


@dataclass(frozen=True)
class SceneObjects:
    """Objects and fragments of a scene.

    Parameters
    ----------
    scene : str
        The scene's id.
    objects : DataFrame
        Objects wholly in the core: columns of `OBJECT_FIELDS`, `object_id` and `pole_id` are 0.
    fragments : DataFrame
        Voxels of the objects that extend into a buffer: columns of `FRAGMENT_FIELDS`.
    part : ndarray of int32, shape (n_core,)
        Object of each point of the core: k + 1 for row k of `objects`, -k - 1 for row k of `fragments`, 0 for none.
        `merging.MergedObjects` has the number in the inventory for each of these values.
    evidence : DataFrame
        Evidence of the objects that extend into a buffer: columns of `EVIDENCE_FIELDS`; empty without evidence.
    """

    scene: str
    objects: pd.DataFrame
    fragments: pd.DataFrame
    part: NDArray[np.int32] = field(default_factory=lambda: np.zeros(0, dtype=np.int32))
    evidence: pd.DataFrame = field(default_factory=lambda: empty_table(EVIDENCE_FIELDS))


def extract_objects(
    xyz: ArrayLike,
    labels: ArrayLike,
    confidence: ArrayLike,
    *,
    classes: Mapping[str, ObjectRule],
    core: ArrayLike | None = None,
    origin: ArrayLike = (0.0, 0.0, 0.0),
    height_above_ground: ArrayLike | None = None,
    scene: str = "scene_00000",
    evidence: ClassEvidence | None = None,
    classifier: Classifier | None = None,
) -> SceneObjects:
    """Extract and measure the objects of a scene.

    Points of one class that are connected form an object. With evidence and a classifier, the class probabilities form
    candidates instead (`candidate_table.raised_labels`), and the classifier gives each a score: the probability that
    it is an object of its kind.

    Parameters
    ----------
    xyz : array-like of shape (n, 3)
        Points of core and buffers, metres relative to `origin`.
    labels : array-like of int, shape (n,)
        Labels of the class scheme.
    confidence : array-like of shape (n,)
        Confidence of the labels, 0 to 1.
    classes : mapping of str to ObjectRule
        Class name to rule, see `rules.rules_for_scheme`.
    core : array-like of bool, shape (n,), optional
        True in the core of the scene; None treats the points as a whole survey. The buffer must be at least as wide as
        the largest tolerance, otherwise fragments of an object at the border are not merged.
    origin : array-like of shape (3,), default zeros
        World coordinates of the origin of `xyz`, metres.
    height_above_ground : array-like of shape (n,), optional
        Heights, metres. Without them the base of an object is its lowest part, and clearances are unknown.
    scene : str, default "scene_00000"
        The scene's id.
    evidence : ClassEvidence, optional
        Class probabilities of the points.
    classifier : Classifier, optional
        A trained object classifier; both or neither are given.

    Returns
    -------
    SceneObjects
        Measured objects, the fragments of objects that extend into a buffer, and the object of each point of the core.

    Raises
    ------
    DataError
        If a coordinate, confidence or height is NaN or infinite, or the shapes differ.
    """
    points = check_xyz(xyz)
    n = len(points)
    label = check_column(labels, n, "labels")
    inside = np.ones(n, dtype=bool) if core is None else check_column(core, n, "core").astype(bool)
    certainty = _finite(confidence, n, "confidence")
    height = None if height_above_ground is None else _finite(height_above_ground, n, "height_above_ground")
    zero = np.asarray(origin, dtype=np.float64)
    cells, forming = None, label
    if evidence is not None and classifier is not None and n and classes:
        cells = SceneCells(points, core=inside, origin=zero, evidence=evidence)
        above = points[:, 2].astype(np.float64) - points[:, 2].min() if height is None else height
        formed = forming_labels(points, above, evidence, cells, rules=classes, classifier=classifier)
        forming = np.where(label >= 0, formed, np.int16(-1))
    found = _FoundObjects(scene, classes, classifier, np.zeros(n, dtype=np.int32))
    for name, rule in classes.items():
        mine = np.flatnonzero(np.isin(forming, rule.labels))
        whole, cut, of_whole, of_cut = find_fragments(
            points.take(mine, axis=0).astype(np.float64),
            core=inside[mine],
            confidence=certainty[mine].astype(np.float64),
            height_above_ground=None if height is None else height[mine].astype(np.float64),
            origin=zero,
            rule=rule,
            disagreeing=~np.isin(label[mine], rule.labels),
        )
        known = None if cells is None else _evidence_of(cells, mine, (whole, of_whole), (cut, of_cut))
        found.add_whole(name, whole, mine, of_whole, known)
        found.add_cut(name, cut, mine, of_cut, known)
    return found.joined(inside)


class _FoundObjects:
    """Objects of a scene class by class: measured rows, fragments at the border, and the object of each point."""

    def __init__(
        self, scene: str, classes: Mapping[str, ObjectRule], classifier: Classifier | None, part: NDArray[np.int32]
    ) -> None:
        self._scene, self._classes, self._classifier, self._part = scene, classes, classifier, part
        self._rows: list[dict[str, Any]] = []
        self._fragments, self._evidence = [empty_table(FRAGMENT_FIELDS)], [empty_table(EVIDENCE_FIELDS)]
        self._n_cut = 0

    def add_whole(
        self,
        name: str,
        whole: pd.DataFrame,
        mine: NDArray[np.int64],
        of_whole: NDArray[np.int64],
        evidence: pd.DataFrame | None,
    ) -> None:
        """Measure the objects of a class that lie within the core."""
        if not len(whole):
            return
        table = whole.assign(object=whole["fragment"].astype(np.int64), scene=0)
        voxels, number, joined_row = join_voxels(table, resolution=self._classes[name].resolution)
        known = None if evidence is None else Evidence(evidence.assign(object=evidence["fragment"]))
        found, owner = measured_rows(
            voxels, number, name, self._classes, [self._scene], evidence=known, classifier=self._classifier
        )
        of_row = np.append(np.where(owner < 0, 0, owner + len(self._rows) + 1)[joined_row], 0)
        self._part[mine] = of_row[of_whole]
        self._rows += found

    def add_cut(
        self,
        name: str,
        cut: pd.DataFrame,
        mine: NDArray[np.int64],
        of_cut: NDArray[np.int64],
        evidence: pd.DataFrame | None,
    ) -> None:
        """Keep the fragments of a class that extend into a buffer."""
        if not len(cut):
            return
        self._part[mine[of_cut >= 0]] = -1 - self._n_cut - of_cut[of_cut >= 0]
        self._fragments.append(cut.assign(**{"class": name}))
        self._n_cut += len(cut)
        if evidence is not None:
            crossing = evidence["fragment"].isin(cut["fragment"].unique())
            self._evidence.append(evidence[crossing].assign(**{"class": name}))

    def joined(self, inside: NDArray[np.bool_]) -> SceneObjects:
        """Return all objects, with the objects of the points inside the core."""
        return SceneObjects(
            self._scene,
            object_table(self._rows),
            _concatenated(self._fragments, FRAGMENT_FIELDS),
            self._part[inside],
            _concatenated(self._evidence, EVIDENCE_FIELDS),
        )


def _evidence_of(
    cells: SceneCells, mine: NDArray[np.int64], *tables: tuple[pd.DataFrame, NDArray[np.int64]]
) -> pd.DataFrame:
    """Return the evidence of the fragments in tables of voxels, each with the row of every point."""
    fragment = np.full(len(mine), -1, dtype=np.int64)
    for table, row in tables:
        fragment[row >= 0] = table["fragment"].to_numpy()[row[row >= 0]]
    kept = np.flatnonzero(fragment >= 0)
    return cells.around(mine[kept], fragment[kept])


def _concatenated(tables: Sequence[pd.DataFrame], fields: Mapping[str, str]) -> pd.DataFrame:
    filled = [table for table in tables if len(table)]
    return pd.concat(filled or tables[:1], ignore_index=True)[list(fields)].astype(fields)


def _finite(values: ArrayLike, n_points: int, name: str) -> NDArray[np.floating]:
    array = check_column(values, n_points, name)
    if not np.isfinite(array).all():
        row = int(np.flatnonzero(~np.isfinite(array))[0])
        raise DataError(f"{name} at row {row} is {array[row]}")
    return array


def measure_points(
    xyz: ArrayLike,
    rule: ObjectRule,
    *,
    height_above_ground: ArrayLike | None = None,
    confidence: ArrayLike | None = None,
    origin: ArrayLike = (0.0, 0.0, 0.0),
) -> ObjectMeasures:
    """Measure one object from its points.

    Parameters
    ----------
    xyz : array-like of shape (n, 3)
        The points of the object, metres relative to `origin`; at least one.
    rule : ObjectRule
        Kind of the object and size of the voxels; the limits of the rule are not applied.
    height_above_ground : array-like of shape (n,), optional
        Heights, metres. Without them the base of the object is its lowest part.
    confidence : array-like of shape (n,), optional
        Confidence of the points, 0 to 1; None is 1.
    origin : array-like of shape (3,), default zeros
        World coordinates of the origin of `xyz`, metres.

    Returns
    -------
    ObjectMeasures
        Measures of the object.

    Raises
    ------
    DataError
        If there is no point, a value is NaN or infinite, or the shapes differ.
    """
    points = check_xyz(xyz).astype(np.float64)
    n = len(points)
    if n == 0:
        raise DataError("an object without points cannot be measured")
    voxels, _ = voxelise(
        points,
        group=np.zeros(n, dtype=np.int32),
        core=np.ones(n, dtype=bool),
        confidence=np.ones(n) if confidence is None else _finite(confidence, n, "confidence").astype(np.float64),
        height_above_ground=None
        if height_above_ground is None
        else _finite(height_above_ground, n, "height_above_ground").astype(np.float64),
        origin=np.asarray(origin, dtype=np.float64),
        resolution=rule.resolution,
    )
    return measure(join_voxels(voxels.assign(object=0, scene=0), resolution=rule.resolution)[0], rule.kind)

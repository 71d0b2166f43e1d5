"""Objects and lines of all scenes of a survey, joined into one table each."""

from collections.abc import Iterator, Mapping, Sequence
from typing import TypedDict, overload

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.scene_key import SceneKey
from mlsroad_pipeline.algorithms.inventory.lines.barriers import join_barriers
from mlsroad_pipeline.algorithms.inventory.lines.extraction import lines_near, numbered
from mlsroad_pipeline.algorithms.inventory.lines.kerbs.kerb_lines import join_kerbs
from mlsroad_pipeline.algorithms.inventory.lines.markings.marking_lines import join_markings
from mlsroad_pipeline.algorithms.inventory.lines.wire_poles import with_utility_poles
from mlsroad_pipeline.algorithms.inventory.lines.wires import join_wires
from mlsroad_pipeline.algorithms.inventory.objects.extraction import SceneObjects
from mlsroad_pipeline.algorithms.inventory.objects.merging import MergedObjects, merge_scenes
from mlsroad_pipeline.algorithms.inventory.objects.object_classifier import ObjectClassifier
from mlsroad_pipeline.algorithms.inventory.objects.rules import ObjectRule
from mlsroad_pipeline.algorithms.inventory.objects.sightings import Sightings, mark_moving, with_sightings
from mlsroad_pipeline.algorithms.inventory.passes import are_comparable, join_pass_lines, join_pass_objects
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.scenes.corridor import CorridorArrays, corridor_from_arrays
from mlsroad_pipeline.algorithms.scenes.trajectory import Trajectory
from mlsroad_pipeline.execution.task import StoredResult
from mlsroad_pipeline.label.written_file import ObjectClasses
from mlsroad_pipeline.model_store.object_classifiers import classifier_of

_MOST_FILES = 1 << 24  # of a pass
_KEPT_ROWS = 500_000  # of fragments, 0.1 KB each, that stay in memory between the two times that scenes are read


class _StoredObjects(Sequence[SceneObjects]):
    """Objects of the scenes of a pass, loaded one scene at a time; the first ones stay in memory."""

    def __init__(
        self, objects: Sequence[StoredResult], fragments: Sequence[StoredResult], evidence: Sequence[StoredResult]
    ) -> None:
        self._handles = list(zip(objects, fragments, evidence, strict=True))
        self._kept: dict[int, SceneObjects] = {}
        self._n_kept = 0

    def __len__(self) -> int:
        return len(self._handles)

    @overload
    def __getitem__(self, index: int) -> SceneObjects: ...

    @overload
    def __getitem__(self, index: slice) -> Sequence[SceneObjects]: ...

    def __getitem__(self, index: int | slice) -> SceneObjects | Sequence[SceneObjects]:
        if isinstance(index, slice):
            return [self[i] for i in range(len(self))[index]]
        if index in self._kept:
            return self._kept[index]
        objects, fragments, evidence = self._handles[index]
        loaded = SceneObjects(objects.key, objects.load(), fragments.load(), evidence=evidence.load())
        if self._n_kept + len(loaded.fragments) <= _KEPT_ROWS:
            self._kept[index] = loaded
            self._n_kept += len(loaded.fragments)
        return loaded


class JoinedObjects(TypedDict):
    """Objects of a survey, their numbers in each scene (see `merging.MergedObjects`), and their classes.

    `lines` are the kerbs, wires and markings of all passes.
    """

    objects: pd.DataFrame
    numbers: dict[str, NDArray[np.uint32]]
    classes: ObjectClasses
    lines: pd.DataFrame


def _sightings(stored: Sequence[StoredResult], passes: Sequence[str]) -> Iterator[Sightings]:
    """Yield the sightings of scenes; files are numbered per pass, and get different numbers in different passes."""
    first = {pass_key: i * _MOST_FILES for i, pass_key in enumerate(passes)}
    for result in stored:
        table = result.load()
        files = table["file"].astype(np.int64) + first[SceneKey.parse(result.key).parent]
        yield Sightings(result.key, table.assign(file=files))


def join_objects(
    corridors: Mapping[str, CorridorArrays],
    objects: Mapping[str, Sequence[StoredResult]],
    fragments: Mapping[str, Sequence[StoredResult]],
    evidence: Mapping[str, Sequence[StoredResult]],
    sightings: Sequence[StoredResult],
    kerbs: Mapping[str, Sequence[StoredResult]],
    wires: Mapping[str, Sequence[StoredResult]],
    barriers: Mapping[str, Sequence[StoredResult]],
    markings: Mapping[str, Sequence[StoredResult]],
    model: ModelBundle,
    *,
    rules: Mapping[str, ObjectRule],
    labels: Mapping[str, int],
    classifier: str,
    least_score: Mapping[str, float],
    least_kerb: float,
    least_marking: float,
    method: str,
    model_version: str,
    join_drives: bool | None,
    within: float | None,
) -> JoinedObjects:
    """Join the objects of all scenes of a survey into one table; `labels` are the classes of the model by name.

    Objects and lines farther than `within` metres from the path of their pass are left out.
    """
    passes, lines = [], []
    for pass_key, arrays in corridors.items():
        corridor = corridor_from_arrays(arrays)
        scenes = _StoredObjects(objects[pass_key], fragments[pass_key], evidence[pass_key])
        trajectory = corridor if isinstance(corridor, Trajectory) else None
        passes.append((scenes, trajectory))
        stored = kerbs[pass_key], wires[pass_key], barriers[pass_key], markings[pass_key]
        found = _lines_of_pass(*stored, trajectory, least_kerb=least_kerb, least_marking=least_marking)
        if within is not None and trajectory is not None:
            found = [lines_near(table, trajectory, within) for table in found]
        lines.append(numbered(found))
    scorer = classifier_of(model) if classifier else None
    joined, numbers = join_inventories(
        passes, rules, classifier=scorer, least_score=least_score, join_drives=join_drives, within=within
    )
    table = mark_moving(with_sightings(joined, numbers, _sightings(sightings, list(corridors))))
    classes: ObjectClasses = {
        "label": np.append(0, table["class"].map(labels)).astype(np.uint8),
        "score": np.append(0.0, table["score"]).astype(np.float32),
    }
    comparable = are_comparable(lines) if join_drives is None else join_drives
    joined_lines = join_pass_lines(lines, comparable=comparable)
    table = with_utility_poles(table.assign(method=method, model_version=model_version), joined_lines)
    return {
        "objects": table,
        "numbers": numbers,
        "classes": classes,
        "lines": joined_lines,
    }


def _lines_of_pass(
    kerbs: Sequence[StoredResult],
    wires: Sequence[StoredResult],
    barriers: Sequence[StoredResult],
    markings: Sequence[StoredResult],
    trajectory: Trajectory | None,
    *,
    least_kerb: float,
    least_marking: float,
) -> list[pd.DataFrame]:
    """Return the lines of a pass, a table per kind; shorter kerbs and markings are left out, metres."""
    kerb_lines = join_kerbs([stored.load() for stored in kerbs], trajectory, least_length=least_kerb)
    wire_lines = join_wires([stored.load() for stored in wires], trajectory)
    stripes = [stored.load() for stored in markings]
    marking_lines = join_markings(stripes, trajectory, kerbs=kerb_lines, least_length=least_marking)
    barrier_lines = join_barriers([stored.load() for stored in barriers], trajectory)
    return [kerb_lines, wire_lines, barrier_lines, marking_lines]


def join_inventories(
    passes: Sequence[tuple[Sequence[SceneObjects], Trajectory | None]],
    rules: Mapping[str, ObjectRule],
    *,
    classifier: ObjectClassifier | None = None,
    least_score: Mapping[str, float] | float = 0.0,
    join_drives: bool | None = None,
    within: float | None = None,
) -> MergedObjects:
    """Merge the objects of all scenes of several passes into one table, without those of a lower score or far away.

    `join_drives`: whether objects of two passes can be one; None decides by their coordinates.
    """
    found = [
        merge_scenes(
            scenes, classes=rules, trajectory=path, classifier=classifier, least_score=least_score, within=within
        )
        for scenes, path in passes
    ]
    tables = [merged.objects for merged in found]
    comparable = are_comparable(tables) if join_drives is None else join_drives
    return join_pass_objects(found, comparable=comparable)

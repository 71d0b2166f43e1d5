"""Tasks of `label`: label a scene, write a labelled file, join the objects of a survey."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TypedDict, overload

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.scene_key import SceneKey
from mlsroad_pipeline.algorithms.inventory.drives import are_comparable, join_drive_lines
from mlsroad_pipeline.algorithms.inventory.extraction import SceneObjects
from mlsroad_pipeline.algorithms.inventory.kerbs.kerb_lines import join_kerbs
from mlsroad_pipeline.algorithms.inventory.lines import numbered
from mlsroad_pipeline.algorithms.inventory.markings.marking_lines import join_markings
from mlsroad_pipeline.algorithms.inventory.rules import ObjectRule
from mlsroad_pipeline.algorithms.inventory.sightings import Sightings, with_sightings
from mlsroad_pipeline.algorithms.inventory.wires import join_wires
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.scenes.cutting import CorridorArrays, corridor_from_arrays, join_pieces
from mlsroad_pipeline.algorithms.scenes.tiling import SceneSpan
from mlsroad_pipeline.algorithms.scenes.trajectory import Trajectory
from mlsroad_pipeline.datasets.models.object_judges import judge_of
from mlsroad_pipeline.execution.run_folder import RunFolder
from mlsroad_pipeline.execution.task import StoredResult
from mlsroad_pipeline.formats.las.copc import copc_path, write_copc
from mlsroad_pipeline.formats.options import ReadOptions
from mlsroad_pipeline.formats.ply.coloured_ply import coloured_path, write_coloured_ply
from mlsroad_pipeline.label.point_labels import ObjectClasses, SceneLabels
from mlsroad_pipeline.label.scene import LabelledScene, LabelSettings, join_inventories, label_new_scene
from mlsroad_pipeline.label.writer import write_labelled


def label_pieces(
    pieces: Sequence[Mapping[str, NDArray]],
    model: ModelBundle,
    *,
    span: SceneSpan,
    settings: LabelSettings,
    name: str,
    source: str,
) -> LabelledScene:
    """Join the pieces of a scene and label it."""
    scene = join_pieces(pieces, span, settings.outliers, source)
    return label_new_scene(scene, model, settings, name=name)


class WrittenFile(TypedDict):
    """Paths of the files written for one file of the survey, and the counts of its points as `LabelCounts`."""

    files: NDArray[np.str_]
    counts: NDArray[np.int64]
    confidences: NDArray[np.int64]


def write_file(
    path: str,
    *,
    scenes: Sequence[StoredResult],
    numbers: Mapping[str, NDArray[np.uint32]],
    classes: ObjectClasses,
    codes: NDArray[np.uint8],
    rows: NDArray[np.int64],
    file: int,
    target: str,
    run: RunFolder,
    options: ReadOptions,
    n_threads: int,
    had_classes: bool | None,
    copc: bool = False,
    coloured_ply: bool = False,
    class_names: Mapping[int, str] | None = None,
) -> WrittenFile:
    """Write a file of a survey with the labels of its points, and move the results to their places."""
    run.check_input(path)
    staged = str(run.staged(target))
    labels = SceneLabels(scenes, rows, file, path, codes=codes, numbers=numbers, classes=classes)
    written = write_labelled(
        *(path, staged, labels),
        options=options,
        n_threads=n_threads,
        had_classes=had_classes,
        class_names=class_names,
    )
    if copc:
        write_copc(staged, copc_path(staged), n_threads=n_threads)
        written.append(Path(copc_path(staged)))
    if coloured_ply:
        write_coloured_ply(staged, coloured_path(staged))
        written.append(Path(coloured_path(staged)))
    run.check_input(path)  # again: it may have been replaced while it was read
    return {
        "files": np.array([str(run.publish(item)) for item in written]),
        "counts": labels.counts["counts"],
        "confidences": labels.counts["confidences"],
    }


class _StoredObjects(Sequence[SceneObjects]):
    """Objects of the scenes of a drive, loaded one scene at a time."""

    def __init__(
        self, objects: Sequence[StoredResult], fragments: Sequence[StoredResult], evidence: Sequence[StoredResult]
    ) -> None:
        self._handles = list(zip(objects, fragments, evidence, strict=True))

    def __len__(self) -> int:
        return len(self._handles)

    @overload
    def __getitem__(self, index: int) -> SceneObjects: ...

    @overload
    def __getitem__(self, index: slice) -> Sequence[SceneObjects]: ...

    def __getitem__(self, index: int | slice) -> SceneObjects | Sequence[SceneObjects]:
        if isinstance(index, slice):
            return [self[i] for i in range(len(self))[index]]
        objects, fragments, evidence = self._handles[index]
        return SceneObjects(objects.key, objects.load(), fragments.load(), evidence=evidence.load())


_MOST_FILES = 1 << 24  # of a drive


class JoinedObjects(TypedDict):
    """Objects of a survey, their numbers in each scene (see `merging.MergedObjects`), and their classes.

    `lines` are the kerbs, wires and markings of all drives.
    """

    objects: pd.DataFrame
    numbers: dict[str, NDArray[np.uint32]]
    classes: ObjectClasses
    lines: pd.DataFrame


def _sightings(stored: Sequence[StoredResult], drives: Sequence[str]) -> Iterator[Sightings]:
    """Yield the sightings of scenes; files are numbered per drive, and get different numbers in different drives."""
    first = {drive: i * _MOST_FILES for i, drive in enumerate(drives)}
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
    markings: Mapping[str, Sequence[StoredResult]],
    model: ModelBundle,
    *,
    rules: Mapping[str, ObjectRule],
    labels: Mapping[str, int],
    judge: str,
    least_score: float,
    least_length: float,
    least_marking: float,
    method: str,
    model_version: str,
    join_drives: bool | None,
) -> JoinedObjects:
    """Join the objects of all scenes of a survey into one table; `labels` are the classes of the model by name."""
    drives, lines = [], []
    for drive, arrays in corridors.items():
        corridor = corridor_from_arrays(arrays)
        scenes = _StoredObjects(objects[drive], fragments[drive], evidence[drive])
        trajectory = corridor if isinstance(corridor, Trajectory) else None
        drives.append((scenes, trajectory))
        edges = join_kerbs([stored.load() for stored in kerbs[drive]], trajectory, least_length=least_length)
        cables = join_wires([stored.load() for stored in wires[drive]], trajectory)
        stripes = [stored.load() for stored in markings[drive]]
        paint = join_markings(stripes, trajectory, kerbs=edges, least_length=least_marking)
        lines.append(numbered([edges, cables, paint]))
    judges = judge_of(model) if judge else None
    joined, numbers = join_inventories(drives, rules, judge=judges, least_score=least_score, join_drives=join_drives)
    table = with_sightings(joined, numbers, _sightings(sightings, list(corridors)))
    classes: ObjectClasses = {
        "label": np.append(0, table["class"].map(labels)).astype(np.uint8),
        "score": np.append(0.0, table["score"]).astype(np.float32),
    }
    table = table.assign(method=method, model_version=model_version)
    comparable = are_comparable(lines) if join_drives is None else join_drives
    return {
        "objects": table,
        "numbers": numbers,
        "classes": classes,
        "lines": join_drive_lines(lines, comparable=comparable),
    }

"""Tasks of `label`: label a scene, write a labelled file, join the objects of a survey."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TypedDict, overload

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.inventory.extraction import SceneObjects
from mlsroad_pipeline.algorithms.inventory.rules import ObjectRule
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.scenes.cutting import CorridorArrays, corridor_from_arrays, join_pieces
from mlsroad_pipeline.algorithms.scenes.tiling import SceneSpan
from mlsroad_pipeline.algorithms.scenes.trajectory import Trajectory
from mlsroad_pipeline.execution.run_folder import RunFolder
from mlsroad_pipeline.execution.task import StoredResult
from mlsroad_pipeline.formats.las.copc import copc_path, write_copc
from mlsroad_pipeline.formats.options import ReadOptions
from mlsroad_pipeline.formats.ply.coloured_ply import coloured_path, write_coloured_ply
from mlsroad_pipeline.label.scene import LabelledScene, LabelSettings, join_inventories, label_new_scene
from mlsroad_pipeline.label.writer import write_labelled

SCENES_IN_MEMORY = 8
"""Largest number of scenes whose labels a writer holds in memory; a file in recording order needs two or three."""


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


class SceneLabels:
    """Labels of a file by row, loaded from the scenes that hold its points.

    Parameters
    ----------
    scenes : sequence of StoredResult
        Stored `CoreLabels` of the scenes.
    rows : ndarray of int64, shape (m, 2)
        First and last row of the file in each scene.
    file : int
        Number of the file in its drive.
    source : str
        Name of the file in messages.
    """

    def __init__(self, scenes: Sequence[StoredResult], rows: NDArray[np.int64], file: int, source: str) -> None:
        self._scenes = list(scenes)
        self._rows = rows
        self._file = file
        self._source = source
        self._loaded: OrderedDict[int, dict[str, NDArray]] = OrderedDict()

    def _open(self, number: int) -> dict[str, NDArray]:
        if number not in self._loaded:
            labels = self._scenes[number].load()
            own = slice(*np.searchsorted(labels["file"], [self._file, self._file + 1]))
            self._loaded[number] = {key: labels[key][own] for key in ("row", "code", "confidence")}
            while len(self._loaded) > SCENES_IN_MEMORY:
                self._loaded.popitem(last=False)
        self._loaded.move_to_end(number)
        return self._loaded[number]

    def __call__(self, start: int, stop: int) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
        """Return codes and confidences of rows `start` to `stop`."""
        codes = np.zeros(stop - start, dtype=np.uint8)
        confidence = np.zeros(stop - start, dtype=np.float32)
        n_labelled = 0
        for number in np.flatnonzero((self._rows[:, 0] < stop) & (self._rows[:, 1] >= start)):
            scene = self._open(int(number))
            part = slice(*np.searchsorted(scene["row"], [start, stop]))
            rows = scene["row"][part] - start
            codes[rows] = scene["code"][part]
            confidence[rows] = scene["confidence"][part]
            n_labelled += len(rows)
        if n_labelled != stop - start:
            missing = stop - start - n_labelled
            raise DataError(f"{self._source}: {missing} of rows {start} to {stop - 1} have no label")
        return codes, confidence


class WrittenFile(TypedDict):
    """Paths of the files written for one file of the survey."""

    files: NDArray[np.str_]


def write_file(
    path: str,
    *,
    scenes: Sequence[StoredResult],
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
    staged = str(run.staged(target))
    labels = SceneLabels(scenes, rows, file, path)
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
    return {"files": np.array([str(run.publish(item)) for item in written])}


class _StoredObjects(Sequence[SceneObjects]):
    """Objects of the scenes of a drive, loaded one scene at a time."""

    def __init__(self, objects: Sequence[StoredResult], fragments: Sequence[StoredResult]) -> None:
        self._handles = list(zip(objects, fragments, strict=True))

    def __len__(self) -> int:
        return len(self._handles)

    @overload
    def __getitem__(self, index: int) -> SceneObjects: ...

    @overload
    def __getitem__(self, index: slice) -> Sequence[SceneObjects]: ...

    def __getitem__(self, index: int | slice) -> SceneObjects | Sequence[SceneObjects]:
        if isinstance(index, slice):
            return [self[i] for i in range(len(self))[index]]
        objects, fragments = self._handles[index]
        return SceneObjects(objects.key, objects.load(), fragments.load())


def join_objects(
    corridors: Mapping[str, CorridorArrays],
    objects: Mapping[str, Sequence[StoredResult]],
    fragments: Mapping[str, Sequence[StoredResult]],
    *,
    rules: Mapping[str, ObjectRule],
    method: str,
    model_version: str,
) -> pd.DataFrame:
    """Join the objects of all scenes of a survey into one table."""
    drives = []
    for drive, arrays in corridors.items():
        corridor = corridor_from_arrays(arrays)
        drives.append(
            (_StoredObjects(objects[drive], fragments[drive]), corridor if isinstance(corridor, Trajectory) else None)
        )
    return join_inventories(drives, rules).assign(method=method, model_version=model_version)

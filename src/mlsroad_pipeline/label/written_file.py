"""Labelled file of a survey: LAS codes, labels of its points by scene and object, writing."""

from collections import OrderedDict
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TypedDict

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.core.codings import CODE_NAMES
from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle, bundle_scheme
from mlsroad_pipeline.execution.run_folder import RunFolder
from mlsroad_pipeline.execution.task import StoredResult
from mlsroad_pipeline.formats.base import ReadOptions
from mlsroad_pipeline.formats.labelled_names import PointLabels
from mlsroad_pipeline.formats.las.copc import copc_path, write_copc
from mlsroad_pipeline.formats.ply.coloured_ply import coloured_path, write_coloured_ply
from mlsroad_pipeline.formats.registry import get_format
from mlsroad_pipeline.label.confidence import N_BINS, count_confidences
from mlsroad_pipeline.label.scene import LabelCounts
from mlsroad_pipeline.label.writer import write_labelled

UNCLASSIFIED, NOISE = 1, 7
"""LAS codes of points without a class and of outliers."""

PRIVATE = 64
"""First LAS code that producers of data may define."""


def point_codes(codes: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the LAS code of each value of `CoreLabels.label`: those of the classes, unclassified, noise."""
    return np.append(codes, np.array([UNCLASSIFIED, NOISE], dtype=np.uint8))


def output_codes(bundle: ModelBundle, scheme: str, schemes: Mapping[str, Any]) -> NDArray[np.uint8]:
    """Return the LAS code of each class of a model."""
    trained = bundle_scheme(bundle)
    if scheme == "asprs":
        return trained.codes()
    if scheme not in schemes:
        raise ParameterError(f"label.scheme {scheme!r} is not configured (schemes: {', '.join(schemes)})")
    return trained.codes(ClassScheme.from_config(scheme, schemes[scheme]))


def code_names(bundle: ModelBundle, scheme: str, schemes: Mapping[str, Any]) -> dict[int, str]:
    """Return the names of the LAS codes that are written: standard ones, and those of the classes from 64."""
    codes = output_codes(bundle, scheme, schemes)
    private: dict[int, list[str]] = {}
    if scheme == "asprs":
        for name, code in zip(bundle_scheme(bundle).classes, codes.tolist(), strict=True):
            private.setdefault(code, []).append(name)
    else:
        private = {
            k + PRIVATE: [name] for k, name in enumerate(ClassScheme.from_config(scheme, schemes[scheme]).classes)
        }
    written = sorted({*codes.tolist(), UNCLASSIFIED, NOISE})
    return {code: CODE_NAMES[code] if code in CODE_NAMES else "/".join(private[code]) for code in written}


SCENES_IN_MEMORY = 8
"""Largest number of scenes whose labels a writer holds in memory; a file in recording order needs two or three."""


class ObjectClasses(TypedDict):
    """Class of the model and score of each object, by its number; number 0 is no object."""

    label: NDArray[np.uint8]
    score: NDArray[np.float32]


class SceneLabels:
    """Labels of a file by row, loaded from the scenes that hold its points, and their counts.

    Withheld points are in no scene: their confidence is NaN. A point has the class of its object. Where that differs
    from its label, its confidence is the score of the object. Kept points of LAS files have their codes of before.
    """

    def __init__(
        self,
        scenes: Sequence[StoredResult],
        rows: NDArray[np.int64],
        file: int,
        source: str,
        *,
        codes: NDArray[np.uint8],
        numbers: Mapping[str, NDArray[np.uint32]],
        classes: ObjectClasses,
        keeps_codes: bool = False,
    ) -> None:
        self._keeps_codes = keeps_codes
        self._scenes = list(scenes)
        self._rows = rows
        self._file = file
        self._codes, self._n_classes = point_codes(codes), len(codes)
        self._numbers, self._classes = numbers, classes
        self._loaded: OrderedDict[int, dict[str, NDArray]] = OrderedDict()
        self.counts: LabelCounts = {
            "counts": np.zeros(self._n_classes + 1, dtype=np.int64),
            "confidences": np.zeros((self._n_classes, N_BINS), dtype=np.int64),
        }

    def _open(self, number: int) -> dict[str, NDArray]:
        if number not in self._loaded:
            handle = self._scenes[number]
            stored = handle.load()
            own = slice(*np.searchsorted(stored["file"], [self._file, self._file + 1]))
            labels = {key: stored[key][own] for key in ("row", "label", "confidence", "kept") if key in stored}
            labels.setdefault("kept", np.zeros(len(labels["row"]), dtype=np.uint8))
            self._loaded[number] = labels | self._of_objects(labels, self._numbers[handle.key][stored["part"][own]])
            while len(self._loaded) > SCENES_IN_MEMORY:
                self._loaded.popitem(last=False)
        self._loaded.move_to_end(number)
        return self._loaded[number]

    def _of_objects(self, labels: Mapping[str, NDArray], object_id: NDArray[np.uint32]) -> dict[str, NDArray]:
        """Return the labels with the classes of the objects."""
        label, confidence = labels["label"].copy(), labels["confidence"].copy()
        differs = (object_id > 0) & (self._classes["label"][object_id] != label)
        changed = np.flatnonzero(differs & (labels["kept"] == 0))
        label[changed] = self._classes["label"][object_id[changed]]
        confidence[changed] = self._classes["score"][object_id[changed]]
        return {"label": label, "confidence": confidence, "object_id": object_id}

    def __call__(self, start: int, stop: int) -> PointLabels:
        """Return codes, confidences and objects of rows `start` to `stop`, and count them."""
        label = np.zeros(stop - start, dtype=np.uint8)
        confidence = np.full(stop - start, np.nan, dtype=np.float32)
        object_id = np.zeros(stop - start, dtype=np.uint32)
        kept = np.zeros(stop - start, dtype=np.uint8)
        for number in np.flatnonzero((self._rows[:, 0] < stop) & (self._rows[:, 1] >= start)):
            scene = self._open(int(number))
            part = slice(*np.searchsorted(scene["row"], [start, stop]))
            rows = scene["row"][part] - start
            label[rows] = scene["label"][part]
            confidence[rows] = scene["confidence"][part]
            object_id[rows] = scene["object_id"][part]
            kept[rows] = scene["kept"][part]
        labelled = np.isfinite(confidence)
        self._count(label[labelled], confidence[labelled])
        codes = self._codes[label]
        return PointLabels(np.where(kept > 0, kept, codes) if self._keeps_codes else codes, confidence, object_id)

    def _count(self, label: NDArray[np.uint8], confidence: NDArray[np.float32]) -> None:
        known = np.where(label < self._n_classes, label.astype(np.int32), -1)
        counts = np.bincount(np.minimum(label, self._n_classes), minlength=self._n_classes + 1)
        self.counts["counts"] += counts
        self.counts["confidences"] += count_confidences(known, confidence, self._n_classes)


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
    keeps_codes = get_format(path).name == "LAS"
    labels = SceneLabels(
        *(scenes, rows, file, path), codes=codes, numbers=numbers, classes=classes, keeps_codes=keeps_codes
    )
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

"""Labelled file of a survey: written to a folder of its run, then moved to its place."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TypedDict

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.execution.run_folder import RunFolder
from mlsroad_pipeline.execution.task import StoredResult
from mlsroad_pipeline.formats.las.copc import copc_path, write_copc
from mlsroad_pipeline.formats.options import ReadOptions
from mlsroad_pipeline.formats.ply.coloured_ply import coloured_path, write_coloured_ply
from mlsroad_pipeline.label.point_labels import ObjectClasses, SceneLabels
from mlsroad_pipeline.label.writer import write_labelled


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

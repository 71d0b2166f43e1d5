"""Storage of chunk qualities as arrays, and the table of all files."""

from collections.abc import Mapping

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.scene_key import SceneKey
from mlsroad_pipeline.algorithms.quality.chunks import ChunkQuality, TimeQuality, merge
from mlsroad_pipeline.algorithms.quality.duplicates import DuplicateSketch
from mlsroad_pipeline.algorithms.quality.report import QualityReport

_COUNTS = ("n_points", "n_not_finite", "n_duplicates", "n_withheld", "n_noise", "n_times_not_finite")


def chunk_to_arrays(chunk: ChunkQuality) -> dict[str, NDArray]:
    """Return the quality of a chunk as named arrays."""
    arrays = {
        "source": np.array(chunk.source),
        "counts": np.array([getattr(chunk, name) for name in _COUNTS], dtype=np.int64),
        "extent": np.array([chunk.low, chunk.high]),
        "cells": chunk.cells,
        "cell_counts": chunk.cell_counts,
        "hashes": chunk.sketch.hashes,
        "hash_counts": chunk.sketch.counts,
        "complete": np.array(chunk.sketch.complete),
        "share": np.array(chunk.sketch.share),
        "columns": np.array(sorted(chunk.columns), dtype=np.str_),
        "classes": np.array(sorted(chunk.classes.items()), dtype=np.int64).reshape(-1, 2),
        "intensity": np.array(chunk.intensity or (), dtype=np.float64),
        "max_gap": np.array(chunk.max_gap),
    }
    if chunk.time is not None:
        arrays["time_bins"] = chunk.time.bins
        arrays["time_range"] = np.array([chunk.time.earliest, chunk.time.latest])
        arrays["time_ends"] = np.array([chunk.time.first, chunk.time.last])
        arrays["time_backward"] = np.array(chunk.time.n_backward)
    return arrays


def chunk_from_arrays(arrays: Mapping[str, NDArray]) -> ChunkQuality:
    """Return the quality of a chunk from stored arrays."""
    time = None
    if "time_bins" in arrays:
        first, last = arrays["time_ends"].tolist()
        earliest, latest = arrays["time_range"][0], arrays["time_range"][1]
        time = TimeQuality(arrays["time_bins"], earliest, latest, first, last, int(arrays["time_backward"]))
    low, high = arrays["extent"]
    span = arrays["intensity"].tolist()
    return ChunkQuality(
        source=str(arrays["source"]),
        low=low,
        high=high,
        cells=arrays["cells"],
        cell_counts=arrays["cell_counts"],
        sketch=DuplicateSketch(
            arrays["hashes"], arrays["hash_counts"], bool(arrays["complete"]), float(arrays["share"])
        ),
        columns=frozenset(arrays["columns"].tolist()),
        classes={int(code): int(count) for code, count in arrays["classes"]},
        time=time,
        intensity=(span[0], span[1]) if span else None,
        max_gap=float(arrays["max_gap"]),
        **dict(zip(_COUNTS, arrays["counts"].tolist(), strict=True)),
    )


def quality_reports(files: Mapping[str, str], chunks: Mapping[str, Mapping[str, NDArray]]) -> dict[str, QualityReport]:
    """Return the quality report of each file."""
    reports = {}
    for name, file in files.items():
        ranges = [chunk_from_arrays(chunks[key]) for key in sorted(chunks) if SceneKey.parse(key).parent == file]
        reports[name] = merge(ranges)
    return reports


def quality_table(files: Mapping[str, str], chunks: Mapping[str, Mapping[str, NDArray]]) -> pd.DataFrame:
    """Return the table of the quality of all files."""
    rows = [{**report.as_row(), "source": name} for name, report in quality_reports(files, chunks).items()]
    table = pd.DataFrame(rows)
    classes = [column for column in table.columns if column.startswith("class_")]
    return table.assign(**{column: table[column].fillna(0).astype("int64") for column in classes})

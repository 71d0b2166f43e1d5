"""Corrections from a labelled LAZ whose classes were edited in another program, such as CloudCompare or QGIS."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.corrections.decisions import Correction
from mlsroad_pipeline.formats.las.header import read_header
from mlsroad_pipeline.formats.las.lookup import class_names
from mlsroad_pipeline.formats.las.records import RecordReader

NEAR = 0.005
"""Largest distance of a point from its original, metres."""

_MOST = 500_000  # points of one correction


def corrections_of_points(
    path: Path, labelled: Path, name: str, names: Mapping[int, str], painted: Mapping[int, NDArray[np.int64]]
) -> tuple[list[Correction], str]:
    """Return the corrections that an edited LAZ holds, and how its points were matched.

    Points are compared in order if both files have the same number of points at the same places, else by coordinates;
    points that are missing in the edited file are unchanged.

    Parameters
    ----------
    path : Path
        The edited file.
    labelled : Path
        The labelled file in the output folder.
    name : str
        Its path below the folder.
    names : mapping of int to str
        Names of the class codes.
    painted : mapping of int to ndarray of int64
        Points of the labelled file that were painted before, by class code; these are not painted again.

    Raises
    ------
    DataError
        If a point of the edited file is none of the labelled file, or a changed class has no name.
    """
    before, after = _points(labelled), _points(path)
    codes = before[1].copy()
    for code, rows in painted.items():
        codes[rows] = code
    same = before[0].shape == after[0].shape and bool((np.abs(before[0] - after[0]) <= NEAR).all())
    if same:
        row = np.arange(len(codes))
    else:
        distance, row = cKDTree(before[0]).query(after[0], distance_upper_bound=NEAR)
        strange = int((~np.isfinite(distance)).sum())
        if strange:
            raise DataError(
                f"{path}: {strange} of {len(row)} points are none of {labelled}: it was shifted or thinned anew; "
                "edit a copy of the labelled file"
            )
    changed = np.flatnonzero(after[1] != codes[row])
    corrections = []
    for code in np.unique(after[1][changed]).tolist():
        if code not in names:
            known = ", ".join(f"{number} {text}" for number, text in sorted(names.items()))
            raise DataError(f"{path}: class {code} has no name; known are {known}")
        rows = np.unique(row[changed][after[1][changed] == code])
        for first in range(0, len(rows), _MOST):
            payload = {"file": name, "points": rows[first : first + _MOST].tolist(), "class": names[code]}
            corrections.append(Correction("paint", payload=payload))
    return corrections, "in order" if same else "by coordinates"


def names_of_codes(path: Path) -> dict[int, str]:
    """Return the names of the class codes of a labelled file."""
    return class_names(read_header(path))


def _points(path: Path) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return coordinates and class codes of a LAS or LAZ file."""
    header = read_header(path)
    field = "raw_classification" if header.point_format < 6 else "classification"
    with RecordReader(path, header) as reader:
        records = reader.read(0, header.n_points)
    xyz = np.stack([records[axis] * header.scale[k] + header.offset[k] for k, axis in enumerate("XYZ")], axis=1)
    mask = 0x1F if header.point_format < 6 else 0xFF
    return xyz, (records[field] & mask).astype(np.int64)

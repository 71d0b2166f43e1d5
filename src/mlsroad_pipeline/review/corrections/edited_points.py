"""Corrections from a labelled LAZ whose classes were edited in another program, such as CloudCompare or QGIS."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.core.codings import CODE_NAMES
from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.formats.las.header import class_names, read_header
from mlsroad_pipeline.formats.las.records import RecordReader
from mlsroad_pipeline.review.corrections.answers import LOOKUP_LENGTH, classes_of_codes
from mlsroad_pipeline.review.corrections.decisions import Correction, Decision
from mlsroad_pipeline.review.corrections.labelled_output import LabelledOutput

NEAR = 0.005
"""Largest distance of a point from its original, metres."""

PRIVATE = 64
"""Code of the first class of a scheme other than the LAS codes."""

_HIGHEST = 31  # class of point formats 0 to 5
_MOST = 500_000  # points of one correction


def corrections_of_points(
    path: Path, labelled: Path, name: str, names: Mapping[int, str], painted: Mapping[int, NDArray[np.int64]]
) -> tuple[list[Correction], str]:
    """Return the corrections that an edited LAZ holds, and how its points were matched.

    Points are compared in order if both files have the same number of points at the same places, else by coordinates;
    points that are missing in the edited file are unchanged.
    """
    before, after = _points(labelled), _points(path)
    point_format, highest = read_header(path).point_format, int(before[1].max(initial=0))
    if point_format < 6 and highest > _HIGHEST:
        raise DataError(
            f"{path} has points of format {point_format}, which keeps classes up to {_HIGHEST}; the labelled file has "
            f"{highest}: save the edited file as LAS 1.4 with point format 6 to 10"
        )
    codes = before[1].copy()
    for code, rows in painted.items():
        codes[rows] = code
    same = before[0].shape == after[0].shape and bool((np.abs(before[0] - after[0]) <= NEAR).all())
    if same:
        row = np.arange(len(codes))
    else:
        distance, row = cKDTree(before[0]).query(after[0], distance_upper_bound=NEAR)
        unmatched = int((~np.isfinite(distance)).sum())
        if unmatched:
            raise DataError(
                f"{path}: {unmatched} of {len(row)} points are not in {labelled}: it was shifted or thinned anew; "
                "edit a copy of the labelled file"
            )
    changed = np.flatnonzero((after[1] != before[1][row]) & (after[1] != codes[row]))
    corrections = []
    for code in np.unique(after[1][changed]).tolist():
        if code not in names:
            known = ", ".join(f"{number} {text}" for number, text in sorted(names.items()))
            raise DataError(f"{path}: class {code} has no name; known are {known}")
        rows = np.unique(row[changed][after[1][changed] == code])
        for first in range(0, len(rows), _MOST):
            points = rows[first : first + _MOST].tolist()
            payload = {"file": name, "points": points, "class": names[code], "n_points": len(codes)}
            corrections.append(Correction("paint", payload=payload))
    return corrections, "in order" if same else "by coordinates"


def names_of_codes(path: Path, output: LabelledOutput) -> dict[int, str]:
    """Return the classes of the codes of a labelled file, by the names of `NamedClasses`.

    A LAS code stands for the classes of the model that are written as this code; these names are joined by a slash.
    """
    written = class_names(read_header(path))
    coarse, scheme = output.written_scheme, output.model_scheme(written)
    if coarse is not None:
        own = {k + PRIVATE: name for k, name in enumerate(coarse.classes)}
        return {code: own.get(code, text) for code, text in written.items() if code in own or code in CODE_NAMES}
    if scheme is None:
        return written
    classes = classes_of_codes(scheme)
    return {code: "/".join(classes[code]) or CODE_NAMES[code] for code, text in written.items() if code in classes}


def painted_before(
    name: str, strokes: Sequence[Decision], names: Mapping[int, str], path: Path
) -> dict[int, NDArray[np.int64]]:
    """Return the points of a labelled file that were painted before, by class code."""
    codes: dict[str, int] = {}
    header = read_header(path)
    for code, text in (*names.items(), *CODE_NAMES.items(), *class_names(header).items()):
        if code in names:
            codes.setdefault(text[:LOOKUP_LENGTH], code)
    painted: dict[int, NDArray[np.int64]] = {}
    for decision in strokes:
        given = decision.correction.payload
        now = codes.get(given["class"][:LOOKUP_LENGTH])
        if now is not None and decision.correction.paints(name, header.n_points):
            rows = np.asarray(given["points"], np.int64)
            painted = {other: np.setdiff1d(old, rows) for other, old in painted.items()}
            painted[now] = np.union1d(painted.get(now, rows[:0]), rows)
    return painted


def _points(path: Path) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return coordinates and class codes of a LAS or LAZ file."""
    header = read_header(path)
    field = "raw_classification" if header.point_format < 6 else "classification"
    with RecordReader(path, header) as reader:
        records = reader.read(0, header.n_points)
    xyz = np.stack([records[axis] * header.scale[k] + header.offset[k] for k, axis in enumerate("XYZ")], axis=1)
    mask = 0x1F if header.point_format < 6 else 0xFF
    return xyz, (records[field] & mask).astype(np.int64)

"""PLY files with points in the colours of their classes, for viewers without classes, or without those above 31."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.palette import las_palette
from mlsroad_pipeline.formats.base import ReadOptions
from mlsroad_pipeline.formats.files import atomic_file
from mlsroad_pipeline.formats.labelled_names import CLASS, CONFIDENCE, OBJECT, RESULTS
from mlsroad_pipeline.formats.las.format import LasFormat

CHUNK = 1_000_000
COLOURED = "_classes.ply"  # ending of the name of a coloured copy
RECORD = np.dtype(
    [
        *(("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("red", "u1"), ("green", "u1"), ("blue", "u1")),
        *((CLASS, "u1"), (CONFIDENCE, "<f4"), (OBJECT, "<u4")),
    ]
)
NAMES = {"<f4": "float", "|u1": "uchar", "<u4": "uint"}


def coloured_path(path: str) -> str:
    """Return the name of the coloured copy, ``_classes.ply``, of a path that ends in ``.laz``."""
    return str(Path(path).with_suffix("")) + COLOURED


def write_coloured_ply(source: str | Path, target: str | Path) -> None:
    """Write the points of a labelled LAS or LAZ file as PLY in the colours of their classes.

    Coordinates are float32 relative to the file's origin, as simple viewers need them; the origin is in a comment.
    Class, confidence and object are kept. `DataError` if the target is the source.
    """
    path, target = Path(source), Path(target)
    if target.exists() and target.samefile(path):
        raise DataError(f"{target} is the file to copy and would be overwritten")
    form, palette = LasFormat(), las_palette()
    info = form.info(path, ReadOptions())
    wanted = tuple(name for name in RESULTS if name in info.columns)
    options = ReadOptions(only=wanted)
    head = [
        *("ply", "format binary_little_endian 1.0", "comment origin " + " ".join(f"{v:.3f}" for v in info.origin)),
        *(f"element vertex {info.n_points}", *_properties(), "end_header"),
    ]
    with atomic_file(target) as stream:
        stream.write(("\n".join(head) + "\n").encode())
        for start in range(0, info.n_points, CHUNK):
            cloud = form.read(path, options, start=start, stop=start + CHUNK)
            records = np.zeros(len(cloud), dtype=RECORD)
            for axis, name in enumerate("xyz"):
                records[name] = cloud.xyz[:, axis]
            codes = _codes(cloud.get(CLASS), len(cloud))
            records[CLASS] = codes
            for axis, name in enumerate(("red", "green", "blue")):
                records[name] = palette[codes, axis]
            for name in (name for name in (CONFIDENCE, OBJECT) if name in cloud):
                records[name] = cloud[name]
            stream.write(records.tobytes())


def _properties() -> list[str]:
    return [f"property {NAMES[RECORD[name].str]} {name}" for name in RECORD.names or ()]


def _codes(values: NDArray | None, n_points: int) -> NDArray[np.uint8]:
    return np.zeros(n_points, np.uint8) if values is None else values.astype(np.uint8)

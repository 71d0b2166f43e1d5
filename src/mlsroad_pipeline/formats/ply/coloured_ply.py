"""PLY files with points in the colours of their classes, for viewers without classes, or without those above 31."""

from pathlib import Path

import numpy as np

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.palette import las_palette
from mlsroad_pipeline.formats.base import ReadOptions
from mlsroad_pipeline.formats.files import atomic_file
from mlsroad_pipeline.formats.labelled_names import CLASS, CONFIDENCE, OBJECT, RESULTS
from mlsroad_pipeline.formats.las.format import LasFormat
from mlsroad_pipeline.formats.ply.header import ply_head

CHUNK = 1_000_000
COLOURED = "_classes.ply"  # ending of the name of a coloured copy
RECORD = np.dtype(
    [
        *(("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("red", "u1"), ("green", "u1"), ("blue", "u1")),
        *((CLASS, "u1"), (CONFIDENCE, "<f4"), (OBJECT, "<u4")),
    ]
)


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
    properties = [(name, RECORD[name].str[1:]) for name in RECORD.names or ()]
    comment = "origin " + " ".join(f"{value:.3f}" for value in info.origin)
    with atomic_file(target) as stream:
        stream.write(ply_head(info.n_points, properties, [comment]))
        for start in range(0, info.n_points, CHUNK):
            cloud = form.read(path, options, start=start, stop=start + CHUNK)
            records = np.zeros(len(cloud), dtype=RECORD)
            for axis, name in enumerate("xyz"):
                records[name] = cloud.xyz[:, axis]
            for name in wanted:
                records[name] = cloud[name]
            for axis, name in enumerate(("red", "green", "blue")):
                records[name] = palette[records[CLASS], axis]
            stream.write(records.tobytes())

"""KITTI and SemanticKITTI scans: ``.bin`` of four float32 a point, with labels in a sibling ``.label``."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ReadError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.formats.base import ReadOptions, WriteOptions
from mlsroad_pipeline.formats.files import check_file, write_atomic
from mlsroad_pipeline.formats.tables import PointTable, TableFormat

RECORD = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4")])
PROBED, FARTHEST = 1000, 1e4  # number of records that are examined, and largest plausible coordinate in metres
LABEL_BITS = 16  # the lower 16 bits of a label are its class, the upper 16 its instance


class KittiFormat(TableFormat):
    """Reader and writer of KITTI scans.

    Labels are searched beside the scan and in ``../labels`` (SemanticKITTI's layout); a scan without them is read
    without `label` and `instance`.
    """

    name = "KITTI"
    extensions: tuple[str, ...] = (".bin",)
    signatures: tuple[bytes, ...] = ()

    def open_table(self, path: Path, options: ReadOptions) -> PointTable:
        """Open a scan: x, y, z, `intensity` and, with labels, `label` uint16 and `instance` int32."""
        scan = _scan(path)
        table = {name: scan[name] for name in RECORD.names or ()}
        labels = label_path(path)
        if labels is not None:
            table["label"] = table["instance"] = _packed(labels, len(scan), path)

        def rows(names: Sequence[str], start: int, stop: int) -> Mapping[str, NDArray]:
            return {name: _column(table, name, start, stop) for name in names}

        return PointTable(tuple(table), len(scan), rows, None, {"labels": labels})

    def write(self, path: Path, cloud: PointCloud, options: WriteOptions) -> None:
        """Write a scan and, where the cloud has `label`, its ``.label`` beside it.

        The format holds x, y, z as float32, intensity, label and instance, and nothing else.
        """
        path = Path(path)
        lost = sorted(set(cloud.columns) - {"intensity", "label", "instance"})
        if lost:
            raise DataError(f"{path}: KITTI scans cannot hold {', '.join(lost)}; drop them or write LAZ or PLY")
        records = np.zeros(len(cloud), dtype=RECORD)
        world = cloud.world_xyz() / options.metres
        for axis, name in enumerate("xyz"):
            records[name] = world[:, axis]
        if "intensity" in cloud:
            records["intensity"] = cloud["intensity"]
        if "label" in cloud:
            write_labels(path.with_suffix(".label"), cloud["label"], cloud.get("instance"))
        write_atomic(path, records.tobytes())


def _scan(path: Path) -> NDArray:
    size = check_file(path).stat().st_size
    if size % RECORD.itemsize:
        raise ReadError(f"{path} has {size} bytes, no multiple of the {RECORD.itemsize} of a KITTI point")
    scan = np.memmap(path, dtype=RECORD, mode="r")
    if size % (5 * 4) == 0 and not _is_scan(scan[:PROBED]) and _has_rings(path):
        raise ReadError(
            f"{path} has records of five numbers (x, y, z, intensity, ring, as in nuScenes), not the four of KITTI: "
            "save it as NPY of shape (n, 5)"
        )
    return scan


def _is_scan(records: NDArray) -> bool:
    """Return whether records have plausible coordinates and intensities."""
    near = [np.abs(records[name]) < FARTHEST for name in "xyz"]
    return bool(np.logical_and.reduce([*near, records["intensity"] >= 0, records["intensity"] <= 65535]).all())


def _has_rings(path: Path) -> bool:
    """Return whether records of five numbers have plausible coordinates and small whole numbers at their end."""
    records = np.fromfile(path, dtype="<f4", count=5 * PROBED).reshape(-1, 5)
    with np.errstate(invalid="ignore"):
        rings = (records[:, 4] >= 0) & (records[:, 4] < 256) & (records[:, 4] == np.floor(records[:, 4]))
        return bool((rings & (np.abs(records[:, :3]) < FARTHEST).all(axis=1)).all())


def label_path(path: Path) -> Path | None:
    """Return the ``.label`` file beside a scan or in ``../labels``; None where there is none."""
    candidates = (path.with_suffix(".label"), path.parent.parent / "labels" / f"{path.stem}.label")
    return next((candidate for candidate in candidates if candidate.is_file()), None)


def _packed(labels: Path, n_points: int, path: Path) -> NDArray[np.uint32]:
    size = check_file(labels).stat().st_size
    if size != 4 * n_points:
        raise ReadError(f"{labels} has {size / 4:g} labels for the {n_points} points of {path}")
    packed: NDArray[np.uint32] = np.fromfile(labels, dtype="<u4")
    return packed


def read_labels(labels: Path, n_points: int, path: Path) -> NDArray[np.uint16]:
    """Return the classes (uint16) of a ``.label`` file that lies apart from its scan ``path``."""
    return (_packed(labels, n_points, path) & (2**LABEL_BITS - 1)).astype(np.uint16)


def _column(table: dict[str, NDArray], name: str, start: int, stop: int) -> NDArray:
    values = table[name][start:stop]
    if name == "label":
        return (values & (2**LABEL_BITS - 1)).astype(np.uint16)
    return (values >> LABEL_BITS).astype(np.int32) if name == "instance" else np.array(values)


def write_labels(path: Path, labels: NDArray, instances: NDArray | None) -> None:
    """Write a ``.label`` file of classes and instances (None: 0); `DataError` for values outside 0 to 65535."""
    parts = [("label", labels), ("instance", np.zeros(len(labels), np.int32) if instances is None else instances)]
    for name, values in parts:
        if len(values) and not 0 <= values.min() <= values.max() < 2**LABEL_BITS:
            raise DataError(f"{path}: {name} {values.min()} to {values.max()} does not fit into {LABEL_BITS} bits")
    packed = parts[0][1].astype("<u4") | parts[1][1].astype("<u4") << LABEL_BITS
    write_atomic(path, packed.astype("<u4").tobytes())

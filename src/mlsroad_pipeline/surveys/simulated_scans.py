"""Single scans of a simulated rotating scanner: range images, and KITTI scans with SemanticKITTI labels."""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY
from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.validation import check_at_least
from mlsroad_pipeline.formats.base import WriteOptions
from mlsroad_pipeline.formats.kitti import KittiFormat, write_labels
from mlsroad_pipeline.simulation.parameters.presets import SimulationParameters
from mlsroad_pipeline.simulation.runtime.survey import SurveyPieces


@dataclass(frozen=True)
class RangeImage:
    """Size and field of view of a range image."""

    # rows, columns: numbers of its rows and columns
    rows: int
    columns: int
    # top, bottom: elevations of its upper and lower edge, degrees
    top: float = 3.0
    bottom: float = -25.0

    def __post_init__(self) -> None:
        check_at_least(self.rows, 1, "rows")
        check_at_least(self.columns, 1, "columns")
        if not self.top > self.bottom:
            raise ParameterError(f"range_image: top must be above bottom, got {self.top!r} and {self.bottom!r}")

    def kept(self, xyz: NDArray[np.float64]) -> NDArray[np.int64]:
        """Return the rows of the last point in each pixel, in order; points are in the scanner's axes, in metres.

        Points above and below the image fall into its first and last row.
        """
        distance = np.linalg.norm(xyz, axis=1)
        elevation = np.degrees(np.arcsin(xyz[:, 2] / np.maximum(distance, 1e-9)))
        turn = 0.5 * (1.0 - np.arctan2(xyz[:, 1], xyz[:, 0]) / np.pi)
        row = np.floor((self.top - elevation) / (self.top - self.bottom) * self.rows)
        column = np.floor(turn * self.columns)
        pixel = np.clip(row, 0, self.rows - 1) * self.columns + np.clip(column, 0, self.columns - 1)
        _, last = np.unique(pixel[::-1], return_index=True)
        return np.sort(len(xyz) - 1 - last).astype(np.int64)


def range_image(config: Mapping[str, Any]) -> RangeImage:
    """Return the range image that a configuration describes."""
    known = [field.name for field in fields(RangeImage)]
    wrong = [*(name for name in config if name not in known), *(n for n in ("rows", "columns") if n not in config)]
    if wrong:
        raise ParameterError(f"range_image has the keys {', '.join(known)}; unknown or missing: {', '.join(wrong)}")
    return RangeImage(**config)


_CODES: dict[int, tuple[str, ...]] = {
    1: ("outlier",),
    10: ("car", "van"),
    11: ("bicycle",),
    13: ("bus",),
    15: ("motorcycle",),
    16: ("train",),
    18: ("truck",),
    20: ("other_vehicle",),
    30: ("person",),
    31: ("rider",),
    40: ("road", "manhole"),
    44: ("parking",),
    48: ("sidewalk", "curb"),
    49: ("other_ground", "trail"),
    50: ("building",),
    51: ("fence", "wall", "guardrail"),
    52: ("stairs", "bridge", "gantry", "bus_shelter", "other_structure"),
    60: ("lane_marking",),
    70: ("tree", "palm", "cycas", "brushwood", "hedge", "other_vegetation"),
    71: ("trunk",),
    72: ("grass", "soil"),
    80: ("utility_pole", "light_pole", "post"),
    81: ("traffic_sign", "station_sign"),
}
_OTHER_OBJECT = 99
_MOVING = {10: 252, 11: 253, 31: 253, 30: 254, 13: 257, 18: 258, 20: 259}


def semantic_kitti_codes() -> NDArray[np.uint16]:
    """Return the SemanticKITTI code of each taxonomy code."""
    table = np.zeros(256, dtype=np.uint16)
    table[[code for code in TAXONOMY.values() if code]] = _OTHER_OBJECT
    for code, names in _CODES.items():
        table[[TAXONOMY[name] for name in names]] = code
    return table


class FrameWriter:
    """Writer of ``velodyne/000000.bin``, ``labels/000000.label``, ``poses.txt`` and ``times.txt``.

    A frame is one revolution, from behind to behind. Its points are in the scanner's axes (x forward, y left, z up) at
    the middle of the revolution, with the motion within it removed by the reported trajectory.
    """

    def __init__(self, folder: Path, parameters: SimulationParameters, pieces: SurveyPieces) -> None:
        self._folder, self._pieces, self._device = folder, pieces, parameters.devices[0]
        if abs(self._device.mounting[2, 0]) < 0.9:
            raise ParameterError(f"frames need a scanner with an upright axis, {parameters.scanner.name!r} has none")
        for name in ("velodyne", "labels"):
            (folder / name).mkdir(parents=True)
        self._codes = semantic_kitti_codes()
        self._numbers: dict[int, int] = {0: 0}
        self._open: list[PointCloud] = []
        self._frame: tuple[int, int] | None = None
        self._poses: list[NDArray[np.float64]] = []
        self._times: list[float] = []

    def write(self, cloud: PointCloud) -> None:
        """Append points in the order of time; a frame is written when the next one begins."""
        cloud = cloud.select(np.flatnonzero(cloud["scanner"] == 0))
        number, local = self._pieces.pass_of(cloud["gps_time"])
        revolution = np.floor(local * self._device.profile_rate + 0.5).astype(np.int64)
        cuts = np.flatnonzero((np.diff(revolution) != 0) | (np.diff(number) != 0)) + 1
        for rows in np.split(np.arange(len(cloud)), cuts):
            if not len(rows):
                continue
            frame = (int(number[rows[0]]), int(revolution[rows[0]]))
            if self._frame is not None and frame != self._frame:
                self._flush()
            self._frame = frame
            self._open.append(cloud.select(rows))

    def close(self) -> None:
        """Write the last frame, and the poses and times of all."""
        self._flush()
        rows = [" ".join(f"{value:.9g}" for value in pose[:3].ravel()) for pose in self._poses]
        (self._folder / "poses.txt").write_text("".join(f"{row}\n" for row in rows), encoding="utf-8")
        (self._folder / "times.txt").write_text("".join(f"{t:.6f}\n" for t in self._times), encoding="utf-8")

    def _flush(self) -> None:
        if self._frame is None:
            return
        number, revolution = self._frame
        time = revolution / self._device.profile_rate
        pose = self._pieces.sensor_pose(number, time, self._device)
        xyz = np.concatenate([part.xyz for part in self._open])
        local = (xyz - pose[:3, 3]) @ pose[:3, :3]
        columns = {
            name: np.concatenate([part[name] for part in self._open]) for name in ("intensity", "label", "instance")
        }
        scan = PointCloud(local, {"intensity": columns["intensity"]}, np.zeros(3), None, "simulated survey")
        name = f"{len(self._poses):06d}"
        KittiFormat().write(self._folder / "velodyne" / f"{name}.bin", scan, WriteOptions(like="none"))
        codes = self._codes[columns["label"]]
        moving = np.isin(columns["instance"], self._pieces.moving_instances())
        for static_code, moving_code in _MOVING.items():
            codes[moving & (codes == static_code)] = moving_code
        write_labels(self._folder / "labels" / f"{name}.label", codes, self._dense(columns["instance"]))
        self._poses.append(pose)
        self._times.append(time)
        self._open = []

    def _dense(self, instances: NDArray[np.int32]) -> NDArray[np.int32]:
        """Renumber instances in the order of appearance, so that 16 bits suffice."""
        values, ranks = np.unique(instances, return_inverse=True)
        for value in values.tolist():
            self._numbers.setdefault(value, len(self._numbers))
        return np.array([self._numbers[value] for value in values.tolist()], dtype=np.int32)[ranks]

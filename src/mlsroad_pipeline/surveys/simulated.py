"""Simulated surveys on disk, as delivered: LAZ, trajectory, images with calibration, and the truth."""

from __future__ import annotations

import json
import logging
import shutil
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO, Self

import numpy as np
from numpy.typing import NDArray
from PIL import Image as Picture

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.validation import check_positive
from mlsroad_pipeline.formats.base import WriteOptions
from mlsroad_pipeline.formats.las.layout import new_header, pack_records
from mlsroad_pipeline.formats.las.writer import RecordWriter
from mlsroad_pipeline.simulation.cameras.cameras import Image
from mlsroad_pipeline.simulation.parameters.presets import (
    LAYOUT,
    PRESETS,
    SimulationParameters,
    expanded_surveys,
    simulation_parameters,
)
from mlsroad_pipeline.simulation.runtime.survey import SurveyPieces, simulate_survey
from mlsroad_pipeline.surveys.simulated_scans import FrameWriter, RangeImage, range_image

SHARE_OF_ESTIMATE = 0.05
"""Share of the length from which on the time left is estimated; the first metres include the start."""

LOG_INTERVAL = 15.0
"""Seconds between two lines."""

logger = logging.getLogger(__name__)


def distance_lines(name: str, length: float) -> Callable[[float], None]:
    """Return a function that reports a distance out of a length in metres, with an estimate of the time left.

    A line is written every `LOG_INTERVAL` seconds: to the log or, in a worker process, which has none, to stderr.
    """
    start = last = time.monotonic()

    def report(distance: float) -> None:
        nonlocal last
        now = time.monotonic()
        if now - last < LOG_INTERVAL or not 0 < distance < length:
            return
        last = now
        left = (now - start) / distance * (length - distance)
        estimate = f", about {left:.0f} s left" if distance >= SHARE_OF_ESTIMATE * length else ""
        line = f"{name}: {distance:.0f} of {length:.0f} m{estimate}"
        if logger.isEnabledFor(logging.INFO):
            logger.info(line)
        else:
            sys.stderr.write(f"{line}\n")

    return report


POINTS, TRAJECTORY = "survey.laz", "trajectory.csv"

SCAN_ANGLE_STEP = 0.006
"""Degrees per unit of the scan angle in LAS 1.4."""


def presets() -> tuple[str, ...]:
    """Return the names of the presets."""
    return tuple(PRESETS)


def selected_surveys(simulation: Mapping[str, Any]) -> dict[str, Mapping[str, Any]]:
    """Return the configurations of the surveys to simulate: none if the simulator is off, or the only one chosen."""
    only, described = simulation["only"], simulation["surveys"]
    if not simulation["enabled"]:
        return {}
    surveys = expanded_surveys({only: described[only]} if only in described else described)
    if only not in (None, *described, *surveys):
        raise ParameterError(f"unknown simulation.only {only!r} (known: {', '.join(surveys)})")
    wanted = surveys if only is None or only in described else {only: surveys[only]}
    return {name: config for name, config in wanted.items() if config is not None}


def configured_survey(config: Mapping[str, Any]) -> tuple[SimulationParameters, SurveyFiles]:
    """Return the simulation parameters and the file layout that a survey's configuration describes."""
    layout = {name: config[name] for name in LAYOUT if name in config}
    if isinstance(layout.get("range_image"), Mapping):
        layout["range_image"] = range_image(layout["range_image"])
    return simulation_parameters(config), SurveyFiles(**layout)


@dataclass(frozen=True)
class SurveyFiles:
    """File layout of a survey."""

    # Street per point file, metres; by default one file holds all points. The memory needed is small in either case.
    piece_length: float | None = None
    # Whether each revolution of the first scanner is also written as a KITTI scan with SemanticKITTI labels; for
    # scanners that rotate about an upright axis
    frames: bool = False
    # Street between single scans, metres, each in a point file of its own; see `SimulationParameters`
    scan_spacing: float | None = None
    range_image: RangeImage | None = None  # Range image to which each scan of a rotating scanner is thinned

    def __post_init__(self) -> None:
        for name in ("piece_length", "scan_spacing"):
            if getattr(self, name) is not None:
                check_positive(getattr(self, name), name)
        if self.piece_length is not None and self.scan_spacing is not None:
            raise ParameterError("piece_length and scan_spacing exclude each other")
        if self.frames and self.scan_spacing is not None:
            raise ParameterError("frames and scan_spacing exclude each other")
        if self.range_image is not None and not isinstance(self.range_image, RangeImage):
            raise ParameterError(f"range_image must be a mapping with rows and columns, got {self.range_image!r}")
        if self.range_image is not None and self.scan_spacing is None:
            raise ParameterError("range_image needs scan_spacing: it thins single scans")

    @property
    def file_length(self) -> float | None:
        """Street per point file, metres; None for one file."""
        return self.scan_spacing if self.piece_length is None else self.piece_length

    def names(self, parameters: SimulationParameters) -> list[str]:
        """Return the names of the point files of a survey, in the order of time."""
        if self.file_length is None:
            return [POINTS]
        count = parameters.passes * int(np.ceil(parameters.length / self.file_length))
        return [f"survey_{k:03d}.laz" for k in range(count)]


def write_simulated_survey(
    *,
    parameters: SimulationParameters,
    folder: str,
    n_threads: int,
    files: SurveyFiles | None = None,
    progress: Callable[[float], None] | None = None,
) -> dict[str, NDArray]:
    """Simulate a survey and write it into a folder, which appears complete or not at all.

    Points are written as they are simulated: a street of kilometres takes no more memory than one of some 200 m.
    """
    progress = progress or distance_lines(Path(folder).name, parameters.length * parameters.passes)
    files = SurveyFiles() if files is None else files
    target = Path(folder)
    fresh = target.with_name(f".{target.name}.new")
    shutil.rmtree(fresh, ignore_errors=True)
    fresh.mkdir(parents=True)
    pieces = SurveyPieces(parameters, n_threads=n_threads)
    frames = FrameWriter(fresh / "frames", parameters, pieces) if files.frames else None
    views: list[dict[str, Any]] = []
    n_points = 0
    with _PointFiles(fresh, files, parameters, pieces, n_threads) as points:
        for cloud, images in pieces:
            points.write(cloud)
            n_points += len(cloud)
            if len(cloud):
                number, seconds = pieces.pass_of(cloud["gps_time"][-1:])
                driven = min(parameters.speed * float(seconds[0]), parameters.length)
                progress(parameters.length * int(number[0]) + driven)
            views += _write_images(images, fresh)
            if frames is not None:
                frames.write(cloud)
    if frames is not None:
        frames.close()
    pieces.trajectory.to_csv(fresh / TRAJECTORY, index=False, float_format="%.6f")
    pieces.objects.to_csv(fresh / "objects.csv", index=False, float_format="%.3f")
    _write_calibration(views, fresh, pieces.origin)
    if target.exists():
        shutil.rmtree(target)
    fresh.rename(target)
    return {"n_points": np.array(n_points), "n_images": np.array(len(views))}


class _PointFiles:
    """Writer of the LAZ files of a survey, one after the other; a context manager."""

    def __init__(
        self, folder: Path, files: SurveyFiles, parameters: SimulationParameters, pieces: SurveyPieces, n_threads: int
    ) -> None:
        self._folder, self._pieces, self._files, self._parameters = folder, pieces, files, parameters
        self._names = files.names(parameters)
        self._options = WriteOptions(like="none")
        self._n_threads = n_threads
        self._current = -1
        self._stream: BinaryIO | None = None
        self._writer: RecordWriter | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._close()

    def write(self, cloud: PointCloud) -> None:
        """Append points to the files of their times."""
        steps = np.round(cloud["scan_angle"] / SCAN_ANGLE_STEP).astype(np.int16)
        cloud = cloud.with_columns(scan_angle=steps)
        for number, part in self._parts(cloud):
            if number != self._current:
                self._open(number, part)
            written = part if self._files.range_image is None else self._thinned(part, self._files.range_image)
            assert self._writer is not None
            self._writer.write(pack_records(written, self._writer.header))

    def _thinned(self, cloud: PointCloud, image: RangeImage) -> PointCloud:
        """Return the points of a scan that its range image keeps."""
        passed, seconds = self._pieces.pass_of(cloud["gps_time"][[0, -1]])
        pose = self._pieces.sensor_pose(int(passed[0]), float(seconds.mean()), self._parameters.devices[0])
        return cloud.select(image.kept((cloud.xyz - pose[:3, 3]) @ pose[:3, :3]))

    def _parts(self, cloud: PointCloud) -> Iterator[tuple[int, PointCloud]]:
        length = self._files.file_length
        if length is None:
            yield 0, cloud
            return
        owner = self._pieces.piece_of(cloud["gps_time"], length)
        for number in np.unique(owner):
            yield int(number), cloud.select(np.flatnonzero(owner == number))

    def _open(self, number: int, cloud: PointCloud) -> None:
        self._close()
        self._stream = (self._folder / self._names[number]).open("w+b")
        header = new_header(cloud, self._options)
        self._writer = RecordWriter(self._stream, header, compress=True, n_threads=self._n_threads)
        self._current = number

    def _close(self) -> None:
        if self._stream is not None and self._writer is not None:
            self._writer.close()
            self._stream.close()
            self._stream = self._writer = None


def _write_images(images: Sequence[Image], folder: Path) -> list[dict[str, Any]]:
    """Write images and their truth, and return their entries of the calibration file."""
    if not images:
        return []
    for kind in ("images", "labels", "instances"):
        (folder / kind).mkdir(exist_ok=True)
    views = []
    for image in images:
        numbers, ranks = np.unique(image.instance, return_inverse=True)
        if numbers[0] != 0:
            numbers, ranks = np.concatenate([[0], numbers]), ranks + 1
        Picture.fromarray(image.rgb).save(folder / "images" / f"{image.name}.png")
        for kind, values in (("labels", image.label), ("instances", ranks.reshape(image.instance.shape))):
            Picture.fromarray(values.astype(np.uint16)).save(folder / kind / f"{image.name}.png")
        views.append(
            {
                "name": image.name,
                "camera": str(image.camera),
                "gps_time": float(image.time),
                "K": np.asarray(image.K).tolist(),
                "distortion": np.asarray(image.distortion).tolist(),
                "R": np.asarray(image.R).tolist(),
                "t": np.asarray(image.t).tolist(),
                "width": int(image.width),
                "height": int(image.height),
                "instances": numbers[1:].tolist(),
            }
        )
    return views


def _write_calibration(views: list[dict[str, Any]], folder: Path, origin: NDArray[np.float64]) -> None:
    """Write one calibration file; poses are in world coordinates minus the origin."""
    if not views:
        return
    calibration = {
        "origin": origin.tolist(),
        "convention": "p_cam = R (p_world - origin) + t; pixel = K distort(p_cam / z); integers at pixel centres",
        "distortion": "k1, k2, p1, p2, k3 (Brown and Conrady)",
        "instances": "pixel value v > 0 of instances/NAME.png is the instance instances[v - 1] of that image",
        "images": views,
    }
    (folder / "calibration.json").write_text(json.dumps(calibration, indent=1) + "\n", encoding="utf-8")


MOST_POINTS = 2_500_000
"""Points of a street to train on from which on it is left out."""


def simulate_street(*, simulation: SimulationParameters) -> dict[str, Any]:
    """Simulate a street; one of too many points is returned without points."""
    survey = simulate_survey(simulation, n_threads=1)
    cloud = survey.cloud.select(np.arange(len(survey.cloud) if len(survey.cloud) <= MOST_POINTS else 0))
    points = {
        "xyz": cloud.xyz.astype(np.float32), "origin": np.asarray(survey.origin), "intensity": cloud["intensity"],
        "truth": cloud["label"].astype(np.uint8), "instance": cloud["instance"].astype(np.int32),
    }  # fmt: skip
    return {"points": points, "objects": survey.objects}

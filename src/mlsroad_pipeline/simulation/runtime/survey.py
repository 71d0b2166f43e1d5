"""Simulated surveys: points, trajectory, images and truth, as a mapping company would deliver them."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import groupby

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud, concatenate
from mlsroad_pipeline.simulation.cameras.cameras import Image, colour_points, spread_colours
from mlsroad_pipeline.simulation.furnishing.blocks import ObjectRecord, block_centre
from mlsroad_pipeline.simulation.model.meshes import rotation_matrix
from mlsroad_pipeline.simulation.objects.dimensions import Measures
from mlsroad_pipeline.simulation.parameters.devices import Device
from mlsroad_pipeline.simulation.parameters.presets import SimulationParameters
from mlsroad_pipeline.simulation.runtime.stream import SurveyStream
from mlsroad_pipeline.simulation.runtime.worker_pool import run_survey
from mlsroad_pipeline.simulation.street.drive import Drive, pose_at
from mlsroad_pipeline.simulation.street.street import Street

_COLOUR_REACH = 0.5  # metres

_OBJECT_COLUMNS = [
    "instance", "label", "x", "y", "z", "moving", "design", "length", "width", "height", "heading", "box_x", "box_y",
    "hard_case", *Measures._fields,
]  # fmt: skip


@dataclass(frozen=True)
class Survey:
    """A simulated survey.

    Parameters
    ----------
    cloud : PointCloud
        Points in the order of gps_time, coordinates relative to `origin`; columns rgb, intensity, gps_time, scanner,
        label (uint8, taxonomy codes), instance (0 is none), return_number, number_of_returns, scan_angle (degrees).
    trajectory : pandas.DataFrame
        Reported trajectory: gps_time, x, y, z (world metres), roll, pitch, heading (radians; see `Drive`).
    images : list of Image
        Images in the order of time.
    objects : pandas.DataFrame
        Truth about each `instance`: instance, label, x, y, z (world metres of the base point; of a moving object when
        the van passes it), moving, design, length, width, height (of the upright box along its front, metres; height is
        that of its top above the base point), heading (of its front, radians counter-clockwise from east), box_x, box_y
        (world metres of the middle of the box), hard_case (kind of confusable neighbour, or empty), and the fields of
        `Measures` for poles and signs (panel_x and panel_y in world metres).
    origin : ndarray of shape (3,), float64
        World coordinates of the local zero, metres.
    crs : str
        Coordinate reference system as WKT.
    street : Street
        The surveyed street.
    """

    cloud: PointCloud
    trajectory: pd.DataFrame
    images: list[Image]
    objects: pd.DataFrame
    origin: NDArray[np.float64]
    crs: str
    street: Street


def simulate_survey(parameters: SimulationParameters, *, n_threads: int = 1) -> Survey:
    """Simulate a survey.

    Parameters
    ----------
    parameters : SimulationParameters
        Survey parameters; see `PRESETS`.
    n_threads : int, default 1
        Number of workers; two take little more than half the time of one.

    Returns
    -------
    Survey
        Points, trajectory, images and truth. The same parameters give the same bytes for any number of workers.

    Raises
    ------
    ParameterError
        If `n_threads` is below 1.
    """
    survey, images = SurveyPieces(parameters, n_threads=n_threads), []
    clouds = []
    for cloud, taken in survey:
        clouds.append(_as_float32(cloud))
        images += taken
    return Survey(
        concatenate(clouds), survey.trajectory, images, survey.objects, survey.origin, survey.crs, survey.street
    )


class SurveyPieces:
    """Survey that is read once, in chunks, coloured by its images; its passes follow each other.

    Parameters
    ----------
    parameters : SimulationParameters
        Survey parameters; see `PRESETS`.
    n_threads : int, default 1
        Number of workers; only the computing time depends on it.

    Raises
    ------
    ParameterError
        If `n_threads` is below 1.
    """

    def __init__(self, parameters: SimulationParameters, *, n_threads: int = 1) -> None:
        self._parameters, self._stream = (
            parameters,
            SurveyStream(parameters, n_threads=n_threads, number=parameters.first_pass),
        )
        self.origin, self.crs, self.street = self._stream.origin, self._stream.crs, self._stream.street
        self._truth: dict[int, ObjectRecord] = {}
        self._present: set[int] = set()
        self._drives: list[Drive] = []

    @property
    def trajectory(self) -> pd.DataFrame:
        """Reported trajectories of the passes read so far; see `Survey`."""
        return pd.concat([drive.table(self._parameters) for drive in self._drives], ignore_index=True)

    @property
    def objects(self) -> pd.DataFrame:
        """Truth about the instances read so far; see `Survey`."""
        return _object_table([r for i, r in self._truth.items() if i in self._present], self.origin)

    def __iter__(self) -> Iterator[tuple[PointCloud, list[Image]]]:
        """Yield points in the order of gps_time, float64 relative to the survey's origin, and new images."""
        stream = self._stream
        for number in range(self._parameters.passes):
            stream = stream if number == 0 else stream.next_pass()
            self._drives.append(stream.drive)
            chunks = _coloured_chunks if self._parameters.with_images else _plain_chunks
            for cloud, images in chunks(stream, self._truth):
                self._present.update(np.unique(cloud["instance"]).tolist())
                yield cloud, images

    def pass_of(self, gps_time: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Return the pass of each time, GPS seconds within the passes read so far, and the seconds since its start."""
        starts = np.array([drive.start for drive in self._drives])
        number = np.searchsorted(starts, gps_time, side="right") - 1
        return number, gps_time - starts[number]

    def piece_of(self, gps_time: NDArray[np.float64], piece_length: float) -> NDArray[np.int64]:
        """Return the piece of street, counted through all passes, that the vehicle was on at each time, in GPS seconds.

        Pieces are `piece_length` metres long.
        """
        per_pass = int(np.ceil(self._parameters.length / piece_length))
        number, time = self.pass_of(gps_time)
        ends = piece_length * np.arange(1, per_pass)
        within = np.zeros(len(time), dtype=np.int64)
        for p in np.unique(number):
            rows = number == p
            passed = np.array([self._drives[p].time_at(end) for end in ends])
            within[rows] = np.searchsorted(passed, time[rows], side="right")
        return number * per_pass + within

    def sensor_pose(self, number: int, time: float, device: Device) -> NDArray[np.float64]:
        """Return the pose of a device, seconds after the start of a pass, as reported, with the axes of the vehicle.

        It is the (4, 4) transformation from the device to the world minus the survey's origin.
        """
        pose = pose_at(self._drives[number].reported, time)
        out = np.eye(4)
        out[:3, :3] = rotation_matrix(pose[5], pose[4], pose[3])
        out[:3, 3] = pose[:3] + out[:3, :3] @ np.asarray(device.lever)
        return out

    def moving_instances(self) -> list[int]:
        """Return the moving instances read so far."""
        return [instance for instance, record in self._truth.items() if record.moving]


def _plain_chunks(stream: SurveyStream, truth: dict[int, ObjectRecord]) -> Iterator[tuple[PointCloud, list[Image]]]:
    for _, kind, value in run_survey(stream):
        if kind == "build":
            truth.update({record.instance: record for record in value.records})
        else:
            yield value, []


def _coloured_chunks(stream: SurveyStream, truth: dict[int, ObjectRecord]) -> Iterator[tuple[PointCloud, list[Image]]]:
    """Yield points as soon as the images of the next block are taken."""
    waiting: list[PointCloud] = []
    taken: list[tuple[list[Image], list[NDArray[np.float32]]]] = []
    for _, results in groupby(run_survey(stream), key=lambda result: result.number):
        scanned: list[PointCloud] = []
        images, depths = list[Image](), list[NDArray[np.float32]]()
        taken = [*taken[-2:], (images, depths)]
        for _, kind, value in results:
            if kind == "build":
                truth.update({record.instance: record for record in value.records})
            elif kind == "scan":
                scanned.append(value)
            else:
                images += value[0]
                depths += value[1]
        for cloud in waiting:
            yield _coloured(cloud, taken), images
            images = []
        if images:
            yield scanned[0].select(np.zeros(0, np.int64)).with_columns(rgb=np.zeros((0, 3), np.uint8)), images
        waiting = scanned
    for cloud in waiting:
        yield _coloured(cloud, taken), []


def _object_table(records: Iterable[ObjectRecord], origin: NDArray[np.float64]) -> pd.DataFrame:
    shift = {"x": origin[0], "y": origin[1], "z": origin[2], "box_x": origin[0], "box_y": origin[1],
             "panel_x": origin[0], "panel_y": origin[1]}  # fmt: skip
    rows = [(r.instance, r.label, *r.base, r.moving, r.design, *r.box, r.hard_case, *r.measures) for r in records]
    table = pd.DataFrame(rows, columns=_OBJECT_COLUMNS)
    return table.assign(**{name: table[name] + value for name, value in shift.items()})


def _as_float32(cloud: PointCloud) -> PointCloud:
    """Return points with float32 coordinates."""
    return replace(cloud, xyz=cloud.xyz.astype(np.float32))


def _coloured(cloud: PointCloud, taken: list[tuple[list[Image], list[NDArray[np.float32]]]]) -> PointCloud:
    images = [image for group, _ in taken for image in group]
    depths = [depth for _, group in taken for depth in group]
    xyz = cloud.xyz.astype(np.float64)
    rgb, seen = colour_points(xyz, cloud["gps_time"], images, depths)
    rgb = spread_colours(xyz, cloud["scanner"], rgb, seen, _COLOUR_REACH)
    return cloud.with_columns(rgb=rgb)


def long_survey(parameters: SimulationParameters, *, n_points: int, n_threads: int = 1) -> SurveyStream:
    """Return a survey without images of a street long enough for a number of points; points are computed on demand.

    Parameters
    ----------
    parameters : SimulationParameters
        Survey parameters; their length and images are not used.
    n_points : int
        Number of points that the street must yield.
    n_threads : int, default 1
        Number of workers. The points do not depend on it.

    Returns
    -------
    SurveyStream
        The survey.

    Raises
    ------
    ParameterError
        If `n_threads` is below 1.
    """
    # About 60 % of the pulses return; a street longer than needed costs nothing.
    pulses = sum(device.pulse_rate for device in parameters.devices)
    length = 60.0 + n_points / (pulses * 0.3) * parameters.speed
    return SurveyStream(replace(parameters, with_images=False), length=length, n_threads=n_threads)


def stream_points(stream: SurveyStream, *, n_points: int) -> Iterator[PointCloud]:
    """Yield the first points of a survey without images in chunks.

    Only a few blocks of street are in memory at a time.

    Parameters
    ----------
    stream : SurveyStream
        The survey.
    n_points : int
        Total number of points, at least 1.

    Yields
    ------
    PointCloud
        Some 100,000s of points each, in the order of gps_time, float32 relative to an origin of each chunk, so that
        streets of any length keep their precision.

    Raises
    ------
    ParameterError
        If `n_points` is below 1.
    DataError
        If the street ends first, because hardly any pulse returned.
    """
    if n_points < 1:
        raise ParameterError(f"n_points must be >= 1, got {n_points!r}")
    left = n_points
    for number, kind, value in run_survey(stream):
        if kind != "scan":
            continue
        shifted = value.moved_to(value.origin + block_centre(stream.street, number)[0])
        part = _as_float32(shifted if len(shifted) <= left else shifted.select(np.arange(left)))
        left -= len(part)
        yield part
        if left == 0:
            return
    raise DataError(f"the street ended {left} points short of {n_points}")

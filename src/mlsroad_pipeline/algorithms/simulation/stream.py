"""A survey made piece by piece: blocks of street come and go as the vehicle passes them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import pandas as pd
from numba import njit
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.exceptions import ParameterError
from mlsroad_pipeline.algorithms.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.simulation.cameras import CAMERAS, Image, take_image
from mlsroad_pipeline.algorithms.simulation.drive import PAUSE, drive_along
from mlsroad_pipeline.algorithms.simulation.ground_mesh import ground_mesh
from mlsroad_pipeline.algorithms.simulation.layout import populate
from mlsroad_pipeline.algorithms.simulation.lighting import draw_light, shade
from mlsroad_pipeline.algorithms.simulation.placement import Box, Placed, box_around
from mlsroad_pipeline.algorithms.simulation.presets import SimulationParameters
from mlsroad_pipeline.algorithms.simulation.receiver import GHOST, receive
from mlsroad_pipeline.algorithms.simulation.scanner import draw_calibration, georeference, send_pulses
from mlsroad_pipeline.algorithms.simulation.scene import Mover, RayScene
from mlsroad_pipeline.algorithms.simulation.standing import Standing, build_standing
from mlsroad_pipeline.algorithms.simulation.street import BLOCK, draw_street, generator
from mlsroad_pipeline.algorithms.simulation.threads import ahead_of, workers
from mlsroad_pipeline.algorithms.simulation.traffic import draw_traffic

_BEHIND, _AHEAD = 1, 2  # blocks around the vehicle's own that rays can meet
_PULSES = 262_144  # pulses of one scanner that are cast at once

PASS_INSTANCES = 10_000_000
"""Moving objects of a further pass are numbered this much higher, as they are others."""


@dataclass(frozen=True)
class _Block:
    """A populated block."""

    standing: Standing
    placed: list[Placed]
    movers: list[Mover]


class ObjectRecord(NamedTuple):
    """The truth about one object.

    Parameters
    ----------
    instance, label : int
        Its number and the taxonomy code of the whole.
    design : str
        Name of what it was built from.
    base : ndarray of shape (3,), float64
        Where it stands, street-local metres; of a moving object when the van passes it.
    moving : bool
        Whether it moves.
    box : Box
        The box around it.
    hard_case : str
        Why it is hard to tell from its neighbour, where it was placed so.
    """

    instance: int
    label: int
    design: str
    base: NDArray[np.float64]
    moving: bool
    box: Box
    hard_case: str


class SurveyStream:
    """A survey that is made piece by piece, so that it need not fit into memory.

    Parameters
    ----------
    parameters : SimulationParameters
        What is surveyed, and how.
    length : float, optional
        Length to survey instead of that of the parameters, metres; of any size.
    n_threads : int, default 1
        Threads to use. The points do not depend on it.
    number : int, default 0
        Which pass through the street it is.
    start : float, optional
        GPS seconds at its start; that of the parameters by default.

    Raises
    ------
    ParameterError
        If `n_threads` is below 1.
    """

    def __init__(
        self, parameters: SimulationParameters, *, length: float | None = None, n_threads: int = 1, number: int = 0,
        start: float | None = None,
    ) -> None:  # fmt: skip
        if n_threads < 1:
            raise ParameterError(f"n_threads must be >= 1, got {n_threads!r}")
        self.parameters, self.n_threads, self.number = parameters, n_threads, number
        self.length = parameters.length if length is None else length
        self.street = draw_street(parameters.seed, length=self.length, parameters=parameters.street)
        self.drive = drive_along(self.street, parameters, length=self.length, number=number, start=start)
        self.light = draw_light(parameters.seed)
        self.origin = np.array([parameters.easting, parameters.northing, parameters.height], dtype=np.float64)
        self.crs = parameters.crs_wkt()
        self._devices = parameters.devices
        self._calibrations = [draw_calibration(parameters, scanner=k) for k in range(len(self._devices))]
        self._blocks: dict[int, _Block] = {}

    @property
    def trajectory(self) -> pd.DataFrame:
        """The reported trajectory of the whole drive."""
        return self.drive.table(self.parameters)

    def next_pass(self) -> SurveyStream:
        """Return the next pass through the same street, which begins `PAUSE` seconds after this one ends."""
        start = self.drive.start + self.drive.duration + PAUSE
        return SurveyStream(
            self.parameters, length=self.length, n_threads=self.n_threads, number=self.number + 1, start=start
        )

    def block_count(self) -> int:
        """Return how many blocks the drive passes."""
        return int(np.ceil(self.length / BLOCK))

    def _centre(self, number: int) -> tuple[NDArray[np.float64], float]:
        xy, heading = self.street.alignment.place([(number + 0.5) * BLOCK], [0.0])
        z = self.street.ground.height([(number + 0.5) * BLOCK], [0.0])
        return np.round(np.array([xy[0, 0], xy[0, 1], z[0]])), float(heading[0])

    def block(self, number: int) -> _Block:
        """Return a populated block; those far behind are forgotten."""
        if number not in self._blocks:
            placed = populate(self.street, number)
            centre, heading = self._centre(number)
            meshes = [ground_mesh(self.street, number), *(p.mesh for p in placed)]
            standing = build_standing(meshes, [0, *(p.instance for p in placed)], centre, heading=heading)
            self._blocks[number] = _Block(standing, placed, self._traffic(number))
            for old in [k for k in self._blocks if k < number - _BEHIND - _AHEAD - 1]:
                del self._blocks[old]
        return self._blocks[number]

    def _traffic(self, number: int) -> list[Mover]:
        if self.number == 0:
            return draw_traffic(self.street, self.drive, number)
        # Others are about when the vehicle comes again.
        other = replace(self.street, seed=self.street.seed + 1_000_003 * self.number)
        added = PASS_INSTANCES * self.number
        return [replace(m, instance=m.instance + added) for m in draw_traffic(other, self.drive, number)]

    def scene(self, number: int) -> RayScene:
        """Return what rays can meet while the vehicle is in a block."""
        near = [number, *(number + k for k in range(1, _AHEAD + 1)), *(number - k for k in range(1, _BEHIND + 1))]
        blocks = {k: self.block(k) for k in sorted(near)}
        movers = [m for k in sorted(near) for m in blocks[k].movers]
        return RayScene(
            self.street, [], [], movers, self._centre(number)[0], n_threads=self.n_threads,
            wetness=self.parameters.wetness, standing=[blocks[k].standing for k in near],
        )  # fmt: skip

    def scenes(self) -> Iterator[tuple[int, RayScene, dict[int, ObjectRecord]]]:
        """Yield number, scene and objects of each block in turn; with threads the next is built meanwhile.

        Yields
        ------
        number : int
            The block.
        scene : RayScene
            What `scene` gives for it.
        objects : dict of int to ObjectRecord
            What `objects` gives while the block is the vehicle's own.
        """

        def build(number: int) -> tuple[int, RayScene, dict[int, ObjectRecord]]:
            return number, self.scene(number), {record.instance: record for record in self.objects()}

        with workers(1 if self.n_threads > 1 else 0) as pool:
            yield from ahead_of(pool, build, range(self.block_count()), 1)

    def scan(self, number: int, scene: RayScene) -> Iterator[PointCloud]:
        """Yield the points measured while the vehicle is in a block.

        Parameters
        ----------
        number : int
            The block, from 0 to `block_count` - 1.
        scene : RayScene
            What `scene` gave for it.

        Yields
        ------
        PointCloud
            Points in the order of gps_time, all scanners together; street-local float64 coordinates. Columns as in
            `Survey`; rgb only without images, which colour the points otherwise.
        """
        start = self.drive.time_at(number * BLOCK)
        end = self.drive.time_at(min((number + 1) * BLOCK, self.length))
        fastest = max(device.pulse_rate for device in self._devices)
        count = max(int(np.ceil((end - start) * fastest / _PULSES)), 1)
        edges = np.linspace(start, end, count + 1)
        jobs = [(s, *edges[k : k + 2]) for k in range(count) for s in range(len(self._devices))]
        with workers(self.n_threads if self.n_threads > 1 else 0) as pool:
            results = ahead_of(pool, lambda job: self._measure(scene, *job), jobs, self.n_threads)
            for _ in range(count):
                yield self._merged([next(results) for _ in self._devices])

    def _measure(self, scene: RayScene, scanner: int, start: float, end: float) -> dict[str, NDArray]:
        """Return coordinates and columns of one scanner's points between two times."""
        device = self._devices[scanner]
        first, last = (int(np.ceil(t * device.pulse_rate)) for t in (start, end))
        pulses = send_pulses(self.drive, device, scanner=scanner, first=first, last=last, centre=scene.centre)
        rng = generator(self.parameters.seed, 21, scanner, first, self.number)
        returns, surfaces = receive(scene, pulses, self.parameters, rng, scanner=scanner)
        rows = returns.pulse
        columns: dict[str, NDArray] = {
            "xyz": georeference(
                pulses, rows, returns.distance, self.drive, device, calibration=self._calibrations[scanner]
            ),
            "intensity": returns.intensity,
            "gps_time": pulses.time[rows] + self.drive.start,
            "scanner": np.full(len(rows), scanner, dtype=np.uint8),
            "label": surfaces.label,
            "instance": np.where(surfaces.label == GHOST, np.int32(0), scene.instances[returns.face]),
            "return_number": returns.number,
            "number_of_returns": returns.total,
            "scan_angle": np.degrees(pulses.angle[rows]).astype(np.float32),
        }
        if not self.parameters.with_images:
            columns["rgb"] = shade(
                surfaces, returns.normal, pulses.rays[rows], returns.distance.astype(np.float32),
                np.ones(len(rows), dtype=np.bool_), self.light, np.zeros((len(rows), 3), dtype=np.float32),
            )  # fmt: skip
        return columns

    def _merged(self, parts: list[dict[str, NDArray]]) -> PointCloud:
        """Return the points of all scanners in the order of time."""
        columns = parts[0]
        for part in parts[1:]:
            places = _places(columns["gps_time"], part["gps_time"])
            columns = {name: _woven(values, part[name], *places) for name, values in columns.items()}
        xyz = columns.pop("xyz")
        return PointCloud(xyz, columns, self.origin, self.crs, "simulated survey")

    def photograph(self, number: int, scene: RayScene) -> tuple[list[Image], list[NDArray[np.float32]]]:
        """Take the images that fall into a block.

        Parameters
        ----------
        number : int
            The block, from 0 to `block_count` - 1.
        scene : RayScene
            What `scene` gave for it.

        Returns
        -------
        images : list of Image
            By time, all cameras at each moment.
        depths : list of ndarray of shape (height, width), float32
            Of each image: depth along the optical axis in metres, infinite in the sky.
        """
        interval = self.parameters.image_interval
        low, high = number * BLOCK, min((number + 1) * BLOCK, self.length)
        shots = [(k, c) for k in range(int(np.ceil(low / interval)), int(np.ceil(high / interval))) for c in CAMERAS]
        before = f"{self.number}_" if self.number else ""

        def take(shot: tuple[int, str]) -> tuple[Image, NDArray[np.float32]]:
            k, camera = shot
            return take_image(
                scene, self.drive, self.light, self.parameters,
                camera=camera, time=self.drive.time_at(k * interval), name=f"{before}{k:05d}_{camera}",
            )  # fmt: skip

        with workers(self.n_threads if self.n_threads > 1 else 0) as pool:
            pairs = list(ahead_of(pool, take, shots, self.n_threads))
        return [image for image, _ in pairs], [depth for _, depth in pairs]

    def objects(self) -> Iterator[ObjectRecord]:
        """Yield the truth about all objects in the blocks held now."""
        for block in self._blocks.values():
            for placed in block.placed:
                if placed.instance:
                    yield ObjectRecord(
                        placed.instance, placed.label, placed.design, placed.base, False, placed.box, placed.hard_case
                    )
            for mover in block.movers:
                motion = mover.motion
                xy, heading = self.street.alignment.place([motion.station], [motion.offset])
                z = self.street.ground.height([motion.station], [motion.offset])
                base = np.array([xy[0, 0], xy[0, 1], z[0]])
                turn = float(heading[0]) + (np.pi if motion.speed < 0 else 0.0)
                around = box_around(mover.mesh, base, turn)
                yield ObjectRecord(mover.instance, mover.label, mover.design, base, True, around, "")


@njit(cache=True, nogil=True)
def _places(first: NDArray[np.float64], second: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return where the rows of two rising sequences go when they are merged; at ties the first leads."""
    of_first, of_second = np.empty(len(first), np.int64), np.empty(len(second), np.int64)
    i = j = 0
    for k in range(len(first) + len(second)):
        if i == len(first) or (j < len(second) and second[j] < first[i]):
            of_second[j] = k
            j += 1
        else:
            of_first[i] = k
            i += 1
    return of_first, of_second


def _woven(first: NDArray, second: NDArray, of_first: NDArray[np.int64], of_second: NDArray[np.int64]) -> NDArray:
    out = np.empty((len(first) + len(second), *first.shape[1:]), dtype=first.dtype)
    out[of_first] = first
    out[of_second] = second
    return out

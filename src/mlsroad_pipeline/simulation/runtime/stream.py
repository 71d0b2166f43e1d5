"""Survey computed block by block: only the blocks of street near the vehicle are in memory."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.simulation.cameras.cameras import CAMERAS, Image, take_image
from mlsroad_pipeline.simulation.cameras.lighting import draw_light, in_the_sun
from mlsroad_pipeline.simulation.furnishing.blocks import Block, block_centre, build_block
from mlsroad_pipeline.simulation.parameters.presets import SimulationParameters
from mlsroad_pipeline.simulation.rays.moving import Mover
from mlsroad_pipeline.simulation.rays.scene import RayScene, StaticGeometry, build_static
from mlsroad_pipeline.simulation.scanning.receiver import GHOST, receive
from mlsroad_pipeline.simulation.scanning.scanner import draw_calibration, georeference, send_pulses
from mlsroad_pipeline.simulation.street.drive import PAUSE, drive_along
from mlsroad_pipeline.simulation.street.street import BLOCK, draw_street, generator

_BEHIND, _AHEAD = 1, 2  # blocks before and after the vehicle's own within range of rays
_APART = 1e-3  # from the start of a piece of street to that of its scan, seconds
_PULSES = 262_144  # pulses of one scanner that are cast at once


class SurveyStream:
    """Survey that is computed block by block, so that it need not fit into memory.

    Parameters
    ----------
    parameters : SimulationParameters
        Survey parameters.
    length : float, optional
        Length to survey instead of that of the parameters, metres; of any size.
    n_threads : int, default 1
        Number of workers. The points do not depend on it.
    number : int, default 0
        Number of the pass through the street.
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
        self._static: dict[int, tuple[StaticGeometry, list[Mover]]] = {}
        self._scene: tuple[int, RayScene] | None = None

    @property
    def trajectory(self) -> pd.DataFrame:
        """Reported trajectory of the whole drive."""
        return self.drive.table(self.parameters)

    def next_pass(self) -> SurveyStream:
        """Return the next pass through the same street, which begins `PAUSE` seconds after this one ends."""
        start = self.drive.start + self.drive.duration + PAUSE
        return SurveyStream(
            self.parameters, length=self.length, n_threads=self.n_threads, number=self.number + 1, start=start
        )

    def block_count(self) -> int:
        """Return the number of blocks along the drive."""
        return int(np.ceil(self.length / BLOCK))

    def build(self, number: int) -> Block:
        """Return a block with its objects."""
        return build_block(self.street, self.drive, number, pass_number=self.number)

    def scene(self, number: int, blocks: Mapping[int, Block] | None = None) -> RayScene:
        """Return the geometry within range of rays while the vehicle is in a block, from the blocks of `near`.

        They are built here by default. Blocks farther behind are dropped.
        """
        if self._scene is not None and self._scene[0] == number:
            return self._scene[1]
        self._static = {k: part for k, part in self._static.items() if k >= number - _BEHIND}
        movers = []
        for k in self.near(number):
            if k not in self._static:
                block = self.build(k) if blocks is None else blocks[k]
                self._static[k] = build_static(block.soup), block.movers
            movers += self._static[k][1]
        order = [number, *(number + k for k in range(1, _AHEAD + 1)), *(number - k for k in range(1, _BEHIND + 1))]
        scene = RayScene(
            self.street, [self._static[k][0] for k in order], movers, block_centre(self.street, number)[0],
            wetness=self.parameters.wetness,
        )  # fmt: skip
        self._scene = number, scene
        return scene

    def near(self, number: int) -> range:
        """Return the numbers of the blocks within range of rays while the vehicle is in a block."""
        return range(number - _BEHIND, number + _AHEAD + 1)

    def spans(self, number: int) -> list[tuple[float, float]]:
        """Return start and end of the intervals in which a block is scanned, seconds since the start of the drive."""
        if self.parameters.scan_spacing is not None:
            return self._single_scans(number, self.parameters.scan_spacing)
        start = self.drive.time_at(number * BLOCK)
        end = self.drive.time_at(min((number + 1) * BLOCK, self.length))
        fastest = max(device.pulse_rate for device in self._devices)
        edges = np.linspace(start, end, max(int(np.ceil((end - start) * fastest / _PULSES)), 1) + 1)
        return [(float(a), float(b)) for a, b in pairwise(edges)]

    def _single_scans(self, number: int, spacing: float) -> list[tuple[float, float]]:
        """Return start and end of the single scans that begin in a block, seconds; none reaches the next scan."""
        low, high = number * BLOCK, min((number + 1) * BLOCK, self.length)
        duration = self.parameters.revolutions / self._devices[0].profile_rate
        spans = []
        for k in range(int(np.ceil(low / spacing)), int(np.ceil(high / spacing))):
            start = self.drive.time_at(k * spacing) + _APART
            last = min(self.drive.time_at(min((k + 1) * spacing, self.length)), self.drive.duration)
            spans.append((start, min(start + duration, last)))
        return [(start, end) for start, end in spans if end > start]

    def moments(self, number: int) -> list[int]:
        """Return the numbers of the image intervals at whose start images are taken in a block."""
        interval = self.parameters.image_interval
        low, high = number * BLOCK, min((number + 1) * BLOCK, self.length)
        return list(range(int(np.ceil(low / interval)), int(np.ceil(high / interval))))

    def scan_span(self, scene: RayScene, start: float, end: float) -> PointCloud:
        """Return the points of all scanners during one of the `spans` of a block, in its `scene`.

        Points are in the order of gps_time, street-local and float64. Columns are those of `Survey`, rgb only without
        images, which colour the points otherwise.
        """
        parts = [self._measure(scene, k, start, end) for k in range(len(self._devices))]
        columns = parts[0]
        if len(parts) > 1:
            order = np.argsort(np.concatenate([part["gps_time"] for part in parts]), kind="stable")
            columns = {name: np.concatenate([part[name] for part in parts])[order] for name in columns}
        xyz = columns.pop("xyz")
        return PointCloud(xyz, columns, self.origin, self.crs, "simulated survey")

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
            columns["rgb"] = in_the_sun(
                surfaces, returns.normal, pulses.rays[rows], returns.distance.astype(np.float32), self.light
            )
        return columns

    def shoot(self, scene: RayScene, moment: int) -> tuple[list[Image], list[NDArray[np.float32]]]:
        """Return the images of all cameras at one of the `moments` of a block, in its `scene`, and their depths.

        Depths are along the optical axis, metres, float32; infinite in the sky.
        """
        prefix = f"{self.number}_" if self.number else ""
        time = self.drive.time_at(moment * self.parameters.image_interval)
        pairs = [
            take_image(
                scene, self.drive, self.light, self.parameters,
                camera=camera, time=time, name=f"{prefix}{moment:05d}_{camera}",
            )
            for camera in CAMERAS
        ]  # fmt: skip
        return [image for image, _ in pairs], [depth for _, depth in pairs]

"""A survey made piece by piece: blocks of street come and go as the van passes them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import NamedTuple, TypeVar

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.exceptions import ParameterError
from mlsroad_pipeline.algorithms.point_cloud import PointCloud, concatenate
from mlsroad_pipeline.algorithms.simulation.cameras import CAMERAS, Image, take_image
from mlsroad_pipeline.algorithms.simulation.drive import drive_along
from mlsroad_pipeline.algorithms.simulation.ground_mesh import ground_mesh
from mlsroad_pipeline.algorithms.simulation.layout import populate
from mlsroad_pipeline.algorithms.simulation.lighting import draw_light, shade
from mlsroad_pipeline.algorithms.simulation.meshes import Mesh
from mlsroad_pipeline.algorithms.simulation.placement import Box, Placed, box_around
from mlsroad_pipeline.algorithms.simulation.presets import SimulationParameters
from mlsroad_pipeline.algorithms.simulation.receiver import Returns, receive
from mlsroad_pipeline.algorithms.simulation.scanner import Pulses, georeference, send_pulses
from mlsroad_pipeline.algorithms.simulation.scene import Mover, RayScene
from mlsroad_pipeline.algorithms.simulation.street import BLOCK, draw_street, generator
from mlsroad_pipeline.algorithms.simulation.surfaces import Surfaces
from mlsroad_pipeline.algorithms.simulation.traffic import draw_traffic

T = TypeVar("T")
R = TypeVar("R")

_BEHIND, _AHEAD = 1, 2  # blocks around the van's own that rays can meet
_PULSES = 400_000  # pulses of one scanner that are cast at once


@dataclass(frozen=True)
class _Block:
    """A populated block."""

    ground: Mesh
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

    Raises
    ------
    ParameterError
        If `n_threads` is below 1.
    """

    def __init__(self, parameters: SimulationParameters, *, length: float | None = None, n_threads: int = 1) -> None:
        if n_threads < 1:
            raise ParameterError(f"n_threads must be >= 1, got {n_threads!r}")
        self.parameters, self.n_threads = parameters, n_threads
        self.length = parameters.length if length is None else length
        self.street = draw_street(parameters.seed, length=self.length, parameters=parameters.street)
        self.drive = drive_along(self.street, parameters, length=self.length)
        self.light = draw_light(parameters.seed)
        self.origin = np.array([parameters.easting, parameters.northing, parameters.height], dtype=np.float64)
        self.crs = parameters.crs_wkt()
        self._blocks: dict[int, _Block] = {}

    @property
    def trajectory(self) -> pd.DataFrame:
        """The reported trajectory of the whole drive."""
        return self.drive.table(self.parameters)

    def block_count(self) -> int:
        """Return how many blocks the drive passes."""
        return int(np.ceil(self.length / BLOCK))

    def block(self, number: int) -> _Block:
        """Return a populated block; those far behind are forgotten."""
        if number not in self._blocks:
            movers = draw_traffic(self.street, self.drive, number)
            self._blocks[number] = _Block(ground_mesh(self.street, number), populate(self.street, number), movers)
            for old in [k for k in self._blocks if k < number - _BEHIND - _AHEAD - 1]:
                del self._blocks[old]
        return self._blocks[number]

    def scene(self, number: int) -> RayScene:
        """Return what rays can meet while the van is in a block."""
        blocks = [self.block(k) for k in range(number - _BEHIND, number + _AHEAD + 1)]
        meshes = [b.ground for b in blocks] + [p.mesh for b in blocks for p in b.placed]
        instances = [0] * len(blocks) + [p.instance for b in blocks for p in b.placed]
        centre_xy, _ = self.street.alignment.place([(number + 0.5) * BLOCK], [0.0])
        z = self.street.ground.height([(number + 0.5) * BLOCK], [0.0])
        centre = np.round(np.array([centre_xy[0, 0], centre_xy[0, 1], z[0]]))
        movers = [m for b in blocks for m in b.movers]
        return RayScene(self.street, meshes, instances, movers, centre, n_threads=self.n_threads)

    def scan(self, number: int, scene: RayScene) -> Iterator[PointCloud]:
        """Yield the points measured while the van is in a block.

        Parameters
        ----------
        number : int
            The block, from 0 to `block_count` - 1.
        scene : RayScene
            What `scene` gave for it.

        Yields
        ------
        PointCloud
            Points in the order of gps_time, both scanners together; street-local float64 coordinates. Columns as in
            `Survey`; rgb only without images, which colour the points otherwise.
        """
        start = self.drive.time_at(number * BLOCK)
        end = self.drive.time_at(min((number + 1) * BLOCK, self.length))
        first, last = (int(np.ceil(t * self.parameters.pulse_rate)) for t in (start, end))
        for low in range(first, last, _PULSES):
            yield self._measure(scene, low, min(low + _PULSES, last))

    def _measure(self, scene: RayScene, first: int, last: int) -> PointCloud:
        def of(scanner: int) -> PointCloud:
            pulses = send_pulses(
                self.drive, self.parameters, scanner=scanner, first=first, last=last, centre=scene.centre
            )
            rng = generator(self.parameters.seed, 21, scanner, first)
            returns, surfaces = receive(scene, pulses, self.parameters, rng)
            return self._points(scene, pulses, returns, surfaces, scanner)

        both = concatenate(self._map(of, [0, 1]))
        return both.select(np.argsort(both["gps_time"], kind="stable"))

    def _map(self, function: Callable[[T], R], items: Sequence[T]) -> list[R]:
        """Apply a function to items in threads; ray casting and compiled code of different items overlap."""
        if self.n_threads == 1:
            return [function(item) for item in items]
        with ThreadPoolExecutor(self.n_threads) as pool:
            return list(pool.map(function, items))

    def _points(
        self, scene: RayScene, pulses: Pulses, returns: Returns, surfaces: Surfaces, scanner: int
    ) -> PointCloud:
        rows = returns.pulse
        columns: dict[str, NDArray] = {
            "intensity": returns.intensity,
            "gps_time": pulses.time[rows] + self.parameters.start_time,
            "scanner": np.full(len(rows), scanner, dtype=np.uint8),
            "label": surfaces.label,
            "instance": scene.instances[returns.face],
            "return_number": returns.number,
            "number_of_returns": returns.total,
            "scan_angle": np.degrees(pulses.angle[rows]).astype(np.float32),
        }
        if not self.parameters.with_images:
            rays = pulses.rays[rows]
            lit = np.ones(len(rows), dtype=np.bool_)
            grain = np.zeros((len(rows), 3), dtype=np.float32)
            columns["rgb"] = shade(
                surfaces, returns.normal, rays, returns.distance.astype(np.float32), lit, self.light, grain
            )
        xyz = georeference(pulses, rows, returns.distance, self.drive, scanner=scanner)
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

        def take(shot: tuple[int, str]) -> tuple[Image, NDArray[np.float32]]:
            k, camera = shot
            return take_image(
                scene, self.drive, self.light, self.parameters,
                camera=camera, time=self.drive.time_at(k * interval), name=f"{k:05d}_{camera}",
            )  # fmt: skip

        pairs = self._map(take, shots)
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

"""Placement of objects in a block of street: on the ground, oriented to the street, without overlaps."""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY
from mlsroad_pipeline.simulation.model.meshes import Design, Mesh
from mlsroad_pipeline.simulation.street.street import BLOCK, MARGIN, Street, generator

INSTANCES_PER_BLOCK = 2048  # Instance numbers reserved for each block, so that they are unique along the street
FOOTPRINT_HEIGHT = 1.7
"""Height below which parts belong to an object's footprint, metres: trunks and cars, not crowns and arms."""

_GAP = 0.04  # free room around a footprint, metres


class Box(NamedTuple):
    """Upright box around an object."""

    # length, width: along and across the object's own x axis, which is its front or arm, metres
    length: float
    width: float
    height: float  # Of its top above its base, metres
    heading: float  # Direction of the x axis, radians counter-clockwise from east
    # x, y: middle of the box, street-local metres; an arm shifts it from the base
    x: float
    y: float


@dataclass(frozen=True)
class Placed:
    """Placed object."""

    label: int  # Taxonomy code of the whole; faces of its mesh may have finer ones
    instance: int  # Instance number, unique along the street; 0 for facades, fences, walls and hedges
    mesh: Mesh  # Faces in street-local coordinates (m)
    base: NDArray[np.float64]  # Base point on the ground (m)
    design: str  # Name of its design
    box: Box  # Its box
    hard_case: str = ""  # Kind of confusable neighbour, if it was placed as such


def _extent(vertices: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    return vertices.min(axis=0), vertices.max(axis=0)


def box_around(mesh: Mesh, base: NDArray[np.float64], heading: float) -> Box:
    """Return the box of a mesh (foot at the origin, front along +x) that is placed at a base and a heading."""
    low, high = _extent(mesh.vertices)
    middle = (low + high) / 2
    c, s = np.cos(heading), np.sin(heading)
    x, y = base[0] + c * middle[0] - s * middle[1], base[1] + s * middle[0] + c * middle[1]
    heading = float(np.angle(np.exp(1j * heading)))
    return Box(float(high[0] - low[0]), float(high[1] - low[1]), float(high[2]), heading, float(x), float(y))


@njit(cache=True, nogil=True)
def overlaps(boxes: NDArray[np.float64], box: NDArray[np.float64], gap: float) -> int:
    """Return the row of the first rectangle that overlaps another one (separating axes), -1 if none.

    Rectangles are middle (x, y), half length, half width (m) and direction (rad); `gap` is the clearance, metres.
    """
    for k in range(len(boxes)):
        other = boxes[k]
        dx, dy = other[0] - box[0], other[1] - box[1]
        apart = False
        for axis in range(4):
            angle = (box[4] if axis < 2 else other[4]) + (np.pi / 2 if axis % 2 else 0.0)
            c, s = np.cos(angle), np.sin(angle)
            reach = gap
            for a in (box, other):
                reach += a[2] * abs(np.cos(a[4] - angle)) + a[3] * abs(np.sin(a[4] - angle))
            if abs(dx * c + dy * s) > reach:
                apart = True
                break
        if not apart:
            return k
    return -1


def _corners(box: NDArray[np.float64]) -> NDArray[np.float64]:
    c, s = np.cos(box[4]), np.sin(box[4])
    along, across = box[2] * np.array([1, 1, -1, -1]), box[3] * np.array([1, -1, 1, -1])
    return np.stack([box[0] + c * along - s * across, box[1] + s * along + c * across])


class Site:
    """Block of a street that is being furnished."""

    def __init__(self, street: Street, block: int) -> None:
        self.street, self.block, self.parameters = street, block, street.parameters
        self.start, self.end = block * BLOCK, (block + 1) * BLOCK
        self.rng = generator(street.seed, 10, block)
        self.placed: list[Placed] = []
        self.where: list[tuple[float, float]] = []  # station and offset of each, NaN for hanging objects
        self.rows: list[int] = []  # its row of `boxes`, -1 for none
        self._boxes = np.empty((256, 5))
        self._count = 0
        self._numbered = 0

    @property
    def boxes(self) -> NDArray[np.float64]:
        """Footprints so far, in station and offset; see `overlaps`."""
        return self._boxes[: self._count]

    def block_out(self, s: float, left: float, half_length: float, half_width: float, angle: float = 0.0) -> None:
        """Keep a rectangle free of later objects."""
        if self._count == len(self._boxes):
            self._boxes = np.concatenate([self._boxes, np.empty_like(self._boxes)])
        self._boxes[self._count] = s, left, half_length, half_width, angle
        self._count += 1

    def toward_road(self, left: float) -> float:
        """Return the direction from a side of the road to the road, relative to the street's."""
        return -np.pi / 2 if left >= 0 else np.pi / 2

    def facing_traffic(self, left: float) -> float:
        """Return the direction towards oncoming traffic on a side of the road, relative to the street's."""
        return 0.0 if left >= 0 else np.pi

    def footprint(self, mesh: Mesh, s: float, left: float, yaw: float) -> NDArray[np.float64]:
        """Return the rectangle of a mesh near the ground, in station and offset."""
        low = mesh.vertices[mesh.vertices[:, 2] < FOOTPRINT_HEIGHT]
        least, most = _extent(low if len(low) else mesh.vertices)
        middle, half = (least[:2] + most[:2]) / 2, (most[:2] - least[:2]) / 2
        c, n = np.cos(yaw), np.sin(yaw)
        return np.array([s + c * middle[0] - n * middle[1], left + n * middle[0] + c * middle[1], *half, yaw])

    def fits(self, box: NDArray[np.float64], *, edge: tuple[float, float] | None = None) -> bool:
        """Return whether a footprint is free and, with `edge`, within these distances from the curb."""
        corners = _corners(box)
        if corners[0].min() < self.start or corners[0].max() > self.end or overlaps(self.boxes, box, _GAP) >= 0:
            return False
        if edge is None:
            return True
        distance, _ = self.street.ground.edge(corners[0], corners[1])
        return bool(distance.min() >= edge[0] and distance.max() <= edge[1])

    def add(
        self, design: Design | tuple[str, str], mesh: Mesh, s: float, left: float, yaw: float, *, tilt: bool = False,
        numbered: bool = True, solid: bool = True, hard_case: str = "",
    ) -> Placed:  # fmt: skip
        """Place a mesh without a check for overlaps."""
        name, label = (design.name, design.label) if isinstance(design, Design) else design
        ground = self.street.ground
        base, heading = self.street.on_ground(s, left)
        turn = heading + yaw
        pitch = roll = 0.0
        if tilt:
            c, n = np.cos(yaw), np.sin(yaw)
            ahead, behind, port, starboard = ground.height(
                [s + c, s - c, s - 0.7 * n, s + 0.7 * n], [left + n, left - n, left + 0.7 * c, left - 0.7 * c]
            )
            pitch, roll = -float(np.arctan((ahead - behind) / 2.0)), float(np.arctan((port - starboard) / 1.4))
        body = mesh.moved([0.0, 0.0, 0.0], pitch=pitch, roll=roll) if tilt else mesh
        self.where.append((s, left))
        self.rows.append(self._count if solid else -1)
        if solid:
            self.block_out(*self.footprint(mesh, s, left, yaw))
        return self._numbered_as(
            Placed(TAXONOMY[label], 0, body.moved(base, yaw=turn), base, name, box_around(body, base, turn), hard_case),
            numbered,
        )

    def _numbered_as(self, placed: Placed, numbered: bool) -> Placed:
        """Append an object, if `numbered` with the next instance number."""
        self._numbered += numbered
        first = (self.block + MARGIN) * INSTANCES_PER_BLOCK
        self.placed.append(replace(placed, instance=first + self._numbered) if numbered else placed)
        return self.placed[-1]

    def add_at(
        self, design: tuple[str, str], mesh: Mesh, start: NDArray[np.float64], end: NDArray[np.float64]
    ) -> Placed:
        """Place a mesh that hangs between two places, in street-local coordinates; its base is below its middle."""
        heading = float(np.arctan2(*(end - start)[1::-1]))
        c, s = np.cos(-heading), np.sin(-heading)
        base = np.array([*((start + end) / 2)[:2], mesh.vertices[:, 2].min()])
        local = mesh.vertices - base
        turned = np.column_stack([c * local[:, 0] - s * local[:, 1], s * local[:, 0] + c * local[:, 1], local[:, 2]])
        around = box_around(Mesh(turned, mesh.faces, mesh.attributes), base, heading)
        self.where.append((np.nan, np.nan))
        self.rows.append(-1)
        return self._numbered_as(Placed(TAXONOMY[design[1]], 0, mesh, base, design[0], around), True)

    def try_add(
        self, design: Design, s: float, left: float, yaw: float, *, edge: tuple[float, float] | None = None,
        tilt: bool = False, mesh: Mesh | None = None,
    ) -> Placed | None:  # fmt: skip
        """Build an object and place it if it fits; see `add` and `fits`."""
        built = design.build(self.rng) if mesh is None else mesh
        if not self.fits(self.footprint(built, s, left, yaw), edge=edge):
            return None
        return self.add(design, built, s, left, yaw, tilt=tilt)

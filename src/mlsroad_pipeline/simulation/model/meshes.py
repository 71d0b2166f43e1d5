"""Triangle meshes with a surface per face, and designs: recipes that build another mesh for every random stream."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

# Kinds of reflection.
DIFFUSE, GLASS, RETRO, FOLIAGE, PAINT, GROUND, BRICK, BARK = range(8)

# Columns of `Mesh.attributes`.
LABEL, KIND, RED, GREEN, BLUE, REFLECTIVITY = range(6)


@dataclass(frozen=True)
class Surface:
    """Surface of faces of one kind."""

    label: int  # Taxonomy code
    rgb: tuple[float, float, float]  # Albedo in the visible, 0 to 1 and linear
    reflectivity: float  # Albedo at the scanner's wavelength, 0 to 1
    kind: int = DIFFUSE  # One of the kinds of this module

    def rows(self, n: int) -> NDArray[np.float32]:
        """Return the attribute rows of n faces."""
        row = np.array([self.label, self.kind, *self.rgb, self.reflectivity], dtype=np.float32)
        return np.broadcast_to(row, (n, 6)).copy()


@dataclass(frozen=True)
class Mesh:
    """Triangle mesh."""

    vertices: NDArray[np.float64]  # Coordinates in metres
    faces: NDArray[np.int64]  # Vertex indices
    attributes: NDArray[np.float32]  # Label, kind, red, green, blue and reflectivity of each face

    def moved(self, translation: ArrayLike, *, yaw: float = 0.0, pitch: float = 0.0, roll: float = 0.0) -> Mesh:
        """Return the mesh rotated by Rz(yaw) Ry(pitch) Rx(roll), radians, then translated."""
        turned = self.vertices @ rotation_matrix(yaw, pitch, roll).T
        return Mesh(turned + np.asarray(translation, dtype=np.float64), self.faces, self.attributes)


def rotation_matrix(yaw: float, pitch: float, roll: float) -> NDArray[np.float64]:
    """Return the rotation Rz(yaw) Ry(pitch) Rx(roll) of column vectors; angles are right-handed, radians."""
    (cy, cp, cr), (sy, sp, sr) = np.cos([yaw, pitch, roll]), np.sin([yaw, pitch, roll])
    return np.array([
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ])  # fmt: skip


def join(meshes: Sequence[Mesh]) -> Mesh:
    """Return one mesh with the faces of all, in order; vertices are not merged."""
    if not meshes:
        return Mesh(np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64), np.zeros((0, 6), dtype=np.float32))
    offsets = np.cumsum([0] + [len(m.vertices) for m in meshes[:-1]])
    return Mesh(
        np.concatenate([m.vertices for m in meshes]),
        np.concatenate([m.faces + offset for m, offset in zip(meshes, offsets, strict=True)]),
        np.concatenate([m.attributes for m in meshes]),
    )


@dataclass(frozen=True)
class Design:
    """One way to build an object of a class."""

    name: str  # Name, unique among all designs, such as ``"double_arm_lamp"``
    label: str  # Taxonomy class of the whole; faces may have finer ones
    # From a random generator to a mesh in metres that stands on z = 0 with its foot at the origin, front or arm along
    # +x. Equal streams give equal meshes; no two streams give the same.
    build: Callable[[np.random.Generator], Mesh]
    clearance: float  # Half of the length along the street that it keeps free, metres
    weight: float = 1.0  # Relative frequency among the designs of its class

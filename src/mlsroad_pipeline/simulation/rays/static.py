"""Static geometry as an acceleration structure for ray casting."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import open3d as o3d
from numba import njit
from numpy.typing import NDArray

from mlsroad_pipeline.simulation.model.compiled import leaf
from mlsroad_pipeline.simulation.model.meshes import Mesh, join

_SLACK = 0.05  # metres


@dataclass(frozen=True)
class StaticGeometry:
    """Piece of static geometry; it is built once and shared by all scenes that contain it."""

    # Faces relative to `centre`, rotated into the frame of `box`: along the axes of a street oblique to them rays meet
    # fewer boxes of the tree
    structure: o3d.t.geometry.RaycastingScene
    attributes: NDArray[np.float32]  # As those of `Mesh`
    instances: NDArray[np.int32]  # Number of each face's object
    centre: NDArray[np.float64]  # Its middle, street-local metres: float32 resolves micrometres around it
    # Cosine and sine of its direction, then bounds along that, to its left, and upwards, relative to `centre`
    box: NDArray[np.float64]


@dataclass(frozen=True)
class TriangleSoup:
    """Faces of a piece of static geometry, as arrays that can be sent to another process."""

    vertices: NDArray[np.float32]  # Relative to `centre`, in the frame of `box`, metres
    faces: NDArray[np.uint32]  # Vertex indices
    # attributes, instances, centre, box: as those of `StaticGeometry`
    attributes: NDArray[np.float32]
    instances: NDArray[np.int32]
    centre: NDArray[np.float64]
    box: NDArray[np.float64]


def triangle_soup(
    meshes: Sequence[Mesh], instances: Sequence[int], centre: NDArray[np.float64], *, heading: float = 0.0
) -> TriangleSoup:
    """Join meshes in street-local coordinates into one triangle soup about a centre, with one instance number per mesh.

    `heading` is the direction of the bounding box, radians; the street's direction gives the tightest box.
    """
    whole = join(meshes)
    c, n = np.cos(heading), np.sin(heading)
    x, y, z = (whole.vertices - centre).T
    vertices = np.stack([c * x + n * y, c * y - n * x, z], axis=1)
    numbers = np.repeat(np.asarray(instances, dtype=np.int32), [len(m.faces) for m in meshes])
    return TriangleSoup(
        vertices.astype(np.float32), whole.faces.astype(np.uint32), whole.attributes, numbers, centre,
        _box(vertices, c, n),
    )  # fmt: skip


def build_static(soup: TriangleSoup) -> StaticGeometry:
    """Build the acceleration structure of a triangle soup.

    One thread builds it: if several did, two runs could resolve hits on edges differently.
    """
    structure = casting_structure(soup.vertices, soup.faces)
    return StaticGeometry(structure, soup.attributes, soup.instances, soup.centre, soup.box)


def static_geometry(
    meshes: Sequence[Mesh], instances: Sequence[int], centre: NDArray[np.float64], *, heading: float = 0.0
) -> StaticGeometry:
    """Build the acceleration structure of meshes; see `triangle_soup` for the parameters."""
    return build_static(triangle_soup(meshes, instances, centre, heading=heading))


def casting_structure(vertices: NDArray, faces: NDArray) -> o3d.t.geometry.RaycastingScene:
    """Return an acceleration structure that is ready for ray casting."""
    scene = o3d.t.geometry.RaycastingScene(nthreads=1)
    scene.add_triangles(
        o3d.core.Tensor.from_numpy(vertices.astype(np.float32, copy=False)),
        o3d.core.Tensor.from_numpy(faces.astype(np.uint32, copy=False)),
    )
    # The first query builds it.
    scene.test_occlusions(o3d.core.Tensor.from_numpy(np.ones((1, 6), np.float32)), nthreads=1)
    return scene


def _box(vertices: NDArray[np.float64], c: float, s: float) -> NDArray[np.float64]:
    if len(vertices) == 0:
        return np.array([c, s, 1.0, -1.0, 1.0, -1.0, 1.0, -1.0])
    return np.array([c, s, *np.stack([vertices.min(axis=0) - _SLACK, vertices.max(axis=0) + _SLACK], axis=1).ravel()])


@njit(cache=True, nogil=True, error_model="numpy")
def rays_entering(
    rays: NDArray[np.float32], limit: NDArray[np.float32], box: NDArray[np.float64], offset: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """Return the rows of the rays that enter a box before their limit, and these rays in the frame of the box."""
    index, moved = np.empty(len(rays), np.int64), np.empty((len(rays), 6), np.float32)
    c, s = box[0], box[1]
    n = 0
    for i in range(len(rays)):
        x, y, dx, dy = rays[i, 0] + offset[0], rays[i, 1] + offset[1], rays[i, 3], rays[i, 4]
        at, pace = c * x + s * y, c * dx + s * dy
        near, far = _within(at, pace, box[2], box[3], 0.0, limit[i])
        if near > far:
            continue
        aside, drift = c * y - s * x, c * dy - s * dx
        near, far = _within(aside, drift, box[4], box[5], near, far)
        up = rays[i, 2] + offset[2]
        near, far = _within(up, rays[i, 5], box[6], box[7], near, far)
        if near > far:
            continue
        index[n] = i
        moved[n, 0], moved[n, 1], moved[n, 2] = at, aside, up
        moved[n, 3], moved[n, 4], moved[n, 5] = pace, drift, rays[i, 5]
        n += 1
    return index[:n], moved[:n]


@leaf
def _within(at: float, pace: float, low: float, high: float, near: float, far: float) -> tuple[float, float]:
    """Return the bounds along a ray between which one coordinate is within its own bounds, cut to those given."""
    inverse = 1.0 / (pace if abs(pace) > 1e-12 else 1e-12)
    a, b = (low - at) * inverse, (high - at) * inverse
    return max(near, min(a, b)), min(far, max(a, b))


@njit(cache=True, nogil=True, error_model="numpy")
def keep_nearer(
    rows: NDArray[np.int64], t: NDArray[np.float32], ids: NDArray[np.uint32], normals: NDArray[np.float32],
    first: int, frame: tuple[float, float], distance: NDArray[np.float32], face: NDArray[np.int32],
    normal: NDArray[np.float32],
) -> None:  # fmt: skip
    """Replace hits of some rays by nearer ones; `frame` has cosine and sine of the frame of the new normals."""
    c, s = frame
    for k in range(len(rows)):
        i = rows[k]
        if t[k] < distance[i]:
            distance[i] = t[k]
            face[i] = first + np.int32(ids[k])
            normal[i, 0] = c * normals[k, 0] - s * normals[k, 1]
            normal[i, 1] = s * normals[k, 0] + c * normals[k, 1]
            normal[i, 2] = normals[k, 2]

"""What stands still, as a structure that rays are cast into."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import open3d as o3d
from numba import njit
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.simulation.meshes import Mesh, join

_SLACK = 0.05  # metres


@dataclass(frozen=True)
class Standing:
    """A piece of what stands still; it is built once and serves all scenes that it is part of.

    Parameters
    ----------
    structure : open3d.t.geometry.RaycastingScene
        Its faces, relative to `centre`.
    attributes : ndarray of shape (f, 6), float32
        As those of `Mesh`.
    instances : ndarray of shape (f,), int32
        Number of each face's object.
    centre : ndarray of shape (3,), float64
        A place in its middle, street-local metres: float32 resolves micrometres around it.
    box : ndarray of shape (8,), float64
        Cosine and sine of its direction, then from and to along that, to its left, and upwards, relative to `centre`.
    """

    structure: o3d.t.geometry.RaycastingScene
    attributes: NDArray[np.float32]
    instances: NDArray[np.int32]
    centre: NDArray[np.float64]
    box: NDArray[np.float64]


@dataclass(frozen=True)
class Soup:
    """The faces of a piece of what stands still, as arrays that another process can be given.

    Parameters
    ----------
    vertices : ndarray of shape (v, 3), float32
        Relative to `centre`, metres.
    faces : ndarray of shape (f, 3), uint32
        Vertex indices.
    attributes, instances, centre, box
        As those of `Standing`.
    """

    vertices: NDArray[np.float32]
    faces: NDArray[np.uint32]
    attributes: NDArray[np.float32]
    instances: NDArray[np.int32]
    centre: NDArray[np.float64]
    box: NDArray[np.float64]


def gather(
    meshes: Sequence[Mesh], instances: Sequence[int], centre: NDArray[np.float64], *, heading: float = 0.0
) -> Soup:
    """Put meshes together.

    Parameters
    ----------
    meshes : sequence of Mesh
        Street-local coordinates.
    instances : sequence of int
        One number per mesh.
    centre : ndarray of shape (3,), float64
        What faces are stored relative to, metres.
    heading : float, default 0
        Direction of the bounding box, radians; along the street it is the tightest.

    Returns
    -------
    Soup
        Their faces.
    """
    whole = join(meshes)
    vertices = whole.vertices - centre
    numbers = np.repeat(np.asarray(instances, dtype=np.int32), [len(m.faces) for m in meshes])
    return Soup(
        vertices.astype(np.float32), whole.faces.astype(np.uint32), whole.attributes, numbers, centre,
        _box(vertices, heading),
    )  # fmt: skip


def stand(soup: Soup) -> Standing:
    """Build the structure that rays are cast into.

    Parameters
    ----------
    soup : Soup
        Its faces.

    Returns
    -------
    Standing
        The structure. It is built by one thread: built by several, two runs could answer a ray that meets an edge with
        different faces.
    """
    structure = casting_structure(soup.vertices, soup.faces)
    return Standing(structure, soup.attributes, soup.instances, soup.centre, soup.box)


def build_standing(
    meshes: Sequence[Mesh], instances: Sequence[int], centre: NDArray[np.float64], *, heading: float = 0.0
) -> Standing:
    """Build the structure of some meshes; see `gather` and `stand`.

    Parameters
    ----------
    meshes, instances, centre, heading
        As for `gather`.

    Returns
    -------
    Standing
        The structure.
    """
    return stand(gather(meshes, instances, centre, heading=heading))


def casting_structure(vertices: NDArray, faces: NDArray) -> o3d.t.geometry.RaycastingScene:
    """Return an acceleration structure that is ready to be cast into."""
    scene = o3d.t.geometry.RaycastingScene(nthreads=1)
    scene.add_triangles(
        o3d.core.Tensor.from_numpy(vertices.astype(np.float32, copy=False)),
        o3d.core.Tensor.from_numpy(faces.astype(np.uint32, copy=False)),
    )
    # The first ray builds it.
    scene.test_occlusions(o3d.core.Tensor.from_numpy(np.ones((1, 6), np.float32)), nthreads=1)
    return scene


def _box(vertices: NDArray[np.float64], heading: float) -> NDArray[np.float64]:
    c, s = np.cos(heading), np.sin(heading)
    if len(vertices) == 0:
        return np.array([c, s, 1.0, -1.0, 1.0, -1.0, 1.0, -1.0])
    x, y, z = vertices.T
    bounds = [(axis.min() - _SLACK, axis.max() + _SLACK) for axis in (c * x + s * y, c * y - s * x, z)]
    return np.array([c, s, *np.ravel(bounds)])


@njit(cache=True, nogil=True, error_model="numpy")
def entering(
    rays: NDArray[np.float32], limit: NDArray[np.float32], box: NDArray[np.float64], offset: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """Return the rays that enter a box before their limit, which they are, and they relative to another centre."""
    index, moved = np.empty(len(rays), np.int64), np.empty((len(rays), 6), np.float32)
    c, s = box[0], box[1]
    origin, direction = np.empty(3), np.empty(3)
    n = 0
    for i in range(len(rays)):
        x, y, dx, dy = rays[i, 0] + offset[0], rays[i, 1] + offset[1], rays[i, 3], rays[i, 4]
        origin[0], origin[1], origin[2] = c * x + s * y, c * y - s * x, rays[i, 2] + offset[2]
        direction[0], direction[1], direction[2] = c * dx + s * dy, c * dy - s * dx, rays[i, 5]
        inward, outward = 0.0, float(limit[i])
        for r in range(3):
            pace = direction[r] if abs(direction[r]) > 1e-12 else 1e-12
            a, b = (box[2 + 2 * r] - origin[r]) / pace, (box[3 + 2 * r] - origin[r]) / pace
            inward, outward = max(inward, min(a, b)), min(outward, max(a, b))
        if inward > outward:
            continue
        index[n] = i
        for r in range(3):
            moved[n, r] = rays[i, r] + offset[r]
            moved[n, 3 + r] = rays[i, 3 + r]
        n += 1
    return index[:n], moved[:n]


@njit(cache=True, nogil=True, error_model="numpy")
def keep_nearer(
    rows: NDArray[np.int64], t: NDArray[np.float32], ids: NDArray[np.uint32], normals: NDArray[np.float32],
    first: int, distance: NDArray[np.float32], face: NDArray[np.int32], normal: NDArray[np.float32],
) -> None:  # fmt: skip
    """Enter answers of some rays where they are nearer than what is known."""
    for k in range(len(rows)):
        i = rows[k]
        if t[k] < distance[i]:
            distance[i] = t[k]
            face[i] = first + np.int32(ids[k])
            for r in range(3):
                normal[i, r] = normals[k, r]

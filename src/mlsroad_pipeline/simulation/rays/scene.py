"""Ray casting into static objects and moving ones, each at its place at the ray's own time."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import open3d as o3d
from numba import njit
from numpy.typing import NDArray

from mlsroad_pipeline.simulation.model.compiled import leaf
from mlsroad_pipeline.simulation.model.meshes import GLASS, KIND, Mesh, join
from mlsroad_pipeline.simulation.rays.moving import Mover, rays_toward, turned
from mlsroad_pipeline.simulation.rays.surfaces import Hits, Surfaces, resolve_hits, water_level
from mlsroad_pipeline.simulation.street.street import Street

_SLACK = 0.05  # metres

_PAST_GLASS = 0.003  # offset of a ray's new origin behind a pane, metres
_PANES = 4  # panes that a ray can pass


@dataclass(frozen=True)
class TriangleSoup:
    """Faces of a piece of static geometry, as arrays that can be sent to another process."""

    # Relative to `centre`, rotated into the frame of `box`, metres: along the axes of a street oblique to them rays
    # meet fewer boxes of the tree
    vertices: NDArray[np.float32]
    faces: NDArray[np.uint32]  # Vertex indices
    attributes: NDArray[np.float32]  # As those of `Mesh`
    instances: NDArray[np.int32]  # Number of each face's object
    centre: NDArray[np.float64]  # Its middle, street-local metres: float32 resolves micrometres around it
    # Cosine and sine of its direction, then bounds along that, to its left, and upwards, relative to `centre`
    box: NDArray[np.float64]


class StaticGeometry(NamedTuple):
    """Piece of static geometry; it is built once and shared by all scenes that contain it."""

    structure: o3d.t.geometry.RaycastingScene
    soup: TriangleSoup


def triangle_soup(
    meshes: Sequence[Mesh], instances: Sequence[int], centre: NDArray[np.float64], *, heading: float
) -> TriangleSoup:
    """Join meshes in street-local coordinates into one triangle soup about a centre, with one instance number per mesh.

    `heading` is the direction of the bounding box, radians; the street's direction gives the tightest box.
    """
    whole = join(meshes)
    c, n = np.cos(heading), np.sin(heading)
    x, y, z = (whole.vertices - centre).T
    vertices = np.stack([c * x + n * y, c * y - n * x, z], axis=1)
    numbers = np.repeat(np.asarray(instances, dtype=np.int32), [len(m.faces) for m in meshes])
    bounds = np.array([1.0, -1.0] * 3)  # of no vertices
    if len(vertices):
        bounds = np.stack([vertices.min(axis=0) - _SLACK, vertices.max(axis=0) + _SLACK], axis=1).ravel()
    return TriangleSoup(
        vertices.astype(np.float32), whole.faces.astype(np.uint32), whole.attributes, numbers, centre,
        np.array([c, n, *bounds]),
    )  # fmt: skip


def build_static(soup: TriangleSoup) -> StaticGeometry:
    """Build the acceleration structure of a triangle soup.

    One thread builds it: if several did, two runs could resolve hits on edges differently.
    """
    return StaticGeometry(casting_structure(soup.vertices, soup.faces), soup)


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


class RayScene:
    """Stretch of street for ray casting."""

    def __init__(
        self, street: Street, static: Sequence[StaticGeometry], movers: Sequence[Mover], centre: NDArray[np.float64],
        *, wetness: float,
    ) -> None:  # fmt: skip
        self.street, self.centre, self.movers, self._water = street, centre, tuple(movers), water_level(wetness)
        self._static, soups = tuple(static), [part.soup for part in static]
        moving = [np.full(len(m.mesh.faces), m.instance, dtype=np.int32) for m in self.movers]
        self.attributes = np.concatenate([*(s.attributes for s in soups), *(m.mesh.attributes for m in self.movers)])
        self.instances = np.concatenate([*(s.instances for s in soups), *moving]).astype(np.int32)
        self._moving = [casting_structure(m.mesh.vertices, m.mesh.faces) for m in self.movers]
        self._first_face = np.cumsum([0, *(len(s.instances) for s in soups), *(len(m) for m in moving)])
        self._motions = np.array([m.motion for m in self.movers], dtype=np.float64).reshape(-1, 4)
        self._reaches = np.array([np.sqrt((m.mesh.vertices**2).sum(axis=1).max()) for m in self.movers])

    def cast(
        self, rays: NDArray[np.float32], times: NDArray[np.float64], *, passing: NDArray[np.float32] | None = None
    ) -> Hits:
        """Return the first hits of rays, (n, 6) origin relative to `centre` and unit direction, at times in seconds.

        A ray passes a pane if its `passing`, a random number in [0, 1), is below its transmission; else none does.
        """
        hits = self._cast_once(rays, times)
        if passing is None:
            return hits
        active, behind = _through_panes(rays, np.arange(len(rays)), rays, hits, self.attributes, passing)
        for _ in range(_PANES):
            if len(active) == 0:
                break
            again = self._cast_once(behind, times[active])
            pending, rest = _through_panes(rays, active, behind, again, self.attributes, passing)
            # Distances from the rays' own origins.
            travelled = ((behind[:, :3] - rays[active, :3]) * rays[active, 3:]).sum(axis=1, dtype=np.float64)
            hits.distance[active] = travelled + again.distance
            hits.face[active], hits.normal[active] = again.face, again.normal
            active, behind = pending, rest
        return hits

    def occluded(self, rays: NDArray[np.float32], times: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return which rays hit anything, glass included; see `cast` for the parameters."""
        blocked = np.zeros(len(rays), dtype=np.bool_)
        limit = np.full(len(rays), np.inf, dtype=np.float32)
        for structure, soup in self._static:
            index, moved = rays_entering(rays, limit, soup.box, self.centre - soup.centre)
            if len(index):
                blocked[index] |= structure.test_occlusions(_tensor(moved), nthreads=1).numpy()
        for k, index, local, _ in self._toward(rays, times):
            blocked[index] |= self._moving[k].test_occlusions(_tensor(local), nthreads=1).numpy()
        return blocked

    def resolve(self, hits: Hits, rays: NDArray[np.float32]) -> Surfaces:
        """Return the surfaces at the hits of `cast`, one row per ray, zero without a hit."""
        street = self.street
        near, _ = street.alignment.locate(self.centre[None, :2])
        return resolve_hits(
            hits.distance, hits.face, rays, self.attributes, self.centre, street.alignment.table,
            street.ground, street.ground_rgb, street.ground_reflectivity, float(near[0]), self._water,
        )  # fmt: skip

    def _toward(
        self, rays: NDArray[np.float32], times: NDArray[np.float64]
    ) -> Iterator[tuple[int, NDArray[np.int64], NDArray[np.float32], NDArray[np.float32]]]:
        """Yield number, rows, rays and headings of each moving object with rays near it."""
        indptr, index, local, yaw = rays_toward(
            rays, times, self._motions, self._reaches, self.centre, self.street.alignment.table, self.street.ground
        )
        for k, (low, high) in enumerate(pairwise(indptr)):
            if high > low:
                yield k, index[low:high], local[low:high], yaw[low:high]

    def _cast_once(self, rays: NDArray[np.float32], times: NDArray[np.float64]) -> Hits:
        n = len(rays)
        hits = Hits(np.full(n, np.inf, np.float32), np.full(n, -1, np.int32), np.zeros((n, 3), np.float32))
        for (structure, soup), first in zip(self._static, self._first_face, strict=False):
            index, moved = rays_entering(rays, hits.distance, soup.box, self.centre - soup.centre)
            if len(index):
                keep_nearer(index, *_first_hits(structure, moved), first, (soup.box[0], soup.box[1]), *hits)
        for k, index, local, yaw in self._toward(rays, times):
            t, ids, normals = _first_hits(self._moving[k], local)
            first = self._first_face[len(self._static) + k]
            keep_nearer(index, t, ids, turned(normals, yaw), first, (1.0, 0.0), *hits)
        return hits


def _first_hits(structure: o3d.t.geometry.RaycastingScene, rays: NDArray[np.float32]) -> list[NDArray]:
    """Return distances, faces and normals of the first hits of rays."""
    result = structure.cast_rays(_tensor(rays), nthreads=1)
    return [result[key].numpy() for key in ("t_hit", "primitive_ids", "primitive_normals")]


def _tensor(rays: NDArray[np.float32]) -> o3d.core.Tensor:
    return o3d.core.Tensor.from_numpy(rays)


@njit(cache=True, nogil=True, error_model="numpy")
def _through_panes(
    rays: NDArray[np.float32], rows: NDArray[np.int64], cast: NDArray[np.float32], hits: Hits,
    attributes: NDArray[np.float32], passing: NDArray[np.float32],
) -> tuple[NDArray[np.int64], NDArray[np.float32]]:  # fmt: skip
    """Return the rows of rays that continue behind the pane they hit, and those rays from there on."""
    active, behind = np.empty(len(rows), np.int64), np.empty((len(rows), 6), np.float32)
    n = 0
    for k in range(len(rows)):
        i = rows[k]
        if hits.face[k] < 0 or attributes[hits.face[k], KIND] != GLASS:
            continue
        slant = 0.0
        for r in range(3):
            slant += rays[i, 3 + r] * hits.normal[k, r]
        if passing[i] >= 0.92 - 0.75 * (1 - abs(slant)) ** 3:
            continue
        active[n] = i
        for r in range(3):
            behind[n, r] = cast[k, r] + (hits.distance[k] + _PAST_GLASS) * rays[i, 3 + r]
            behind[n, 3 + r] = rays[i, 3 + r]
        n += 1
    return active[:n], behind[:n].copy()

"""Ray casting into static and moving objects, each at its place at the ray's own time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np
import open3d as o3d
from numba import njit
from numpy.typing import NDArray

from mlsroad_pipeline.simulation.model.meshes import GLASS, KIND, Mesh
from mlsroad_pipeline.simulation.rays.moving import Motion, Mover, rays_toward, turned
from mlsroad_pipeline.simulation.rays.static import (
    StaticGeometry,
    casting_structure,
    keep_nearer,
    rays_entering,
    static_geometry,
)
from mlsroad_pipeline.simulation.rays.surfaces import Hits, Surfaces, resolve_hits, water_level
from mlsroad_pipeline.simulation.street.street import Street

__all__ = ["Motion", "Mover", "RayScene"]

_PAST_GLASS = 0.003  # offset of a ray's new origin behind a pane, metres
_PANES = 4  # panes that a ray can pass


class RayScene:
    """Stretch of street for ray casting."""

    def __init__(
        self, street: Street, meshes: Sequence[Mesh], instances: Sequence[int], movers: Sequence[Mover],
        centre: NDArray[np.float64], *, n_threads: int = 1, wetness: float = 0.0,
        static: Sequence[StaticGeometry] = (),
    ) -> None:  # fmt: skip
        self.n_threads, self._water = n_threads, water_level(wetness)
        self.street, self.centre, self.movers = street, centre, tuple(movers)
        own = [static_geometry(meshes, instances, centre)] if meshes else []
        self._static = (*own, *static)
        moving = [np.full(len(m.mesh.faces), m.instance, dtype=np.int32) for m in self.movers]
        self.attributes = np.concatenate(
            [*(part.attributes for part in self._static), *(m.mesh.attributes for m in self.movers)]
        )
        self.instances = np.concatenate([*(part.instances for part in self._static), *moving]).astype(np.int32)
        self._moving = [casting_structure(m.mesh.vertices, m.mesh.faces) for m in self.movers]
        counts = [0, *(len(part.instances) for part in self._static), *(len(m) for m in moving)]
        self._first_face = np.cumsum(counts)
        self._motions = np.array([m.motion for m in self.movers], dtype=np.float64).reshape(-1, 4)
        self._reaches = np.array([np.sqrt((m.mesh.vertices**2).sum(axis=1).max()) for m in self.movers])

    def cast(
        self, rays: NDArray[np.float32], times: NDArray[np.float64], *, passing: NDArray[np.float32] | None = None
    ) -> Hits:
        """Cast rays of shape (n, 6), origin relative to `centre` and unit direction, and return the first hit of each.

        `times` are the seconds at which rays are sent. A ray passes a pane if its `passing`, a random number in [0, 1),
        is below the pane's transmission; without `passing` no ray does.
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
            _replace(hits, active, behind, again, rays)
            active, behind = pending, rest
        return hits

    def occluded(self, rays: NDArray[np.float32], times: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return which rays hit anything, glass included; see `cast` for the parameters."""
        blocked = np.zeros(len(rays), dtype=np.bool_)
        limit = np.full(len(rays), np.inf, dtype=np.float32)
        for part in self._static:
            index, moved = rays_entering(rays, limit, part.box, self.centre - part.centre)
            if len(index):
                blocked[index] |= part.structure.test_occlusions(_tensor(moved), nthreads=self.n_threads).numpy()
        for k, index, local, _ in self._toward(rays, times):
            blocked[index] |= self._moving[k].test_occlusions(_tensor(local), nthreads=self.n_threads).numpy()
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
        for part, first in zip(self._static, self._first_face, strict=False):
            index, moved = rays_entering(rays, hits.distance, part.box, self.centre - part.centre)
            if len(index) == 0:
                continue
            result = part.structure.cast_rays(_tensor(moved), nthreads=self.n_threads)
            t, ids, normals = (result[key].numpy() for key in ("t_hit", "primitive_ids", "primitive_normals"))
            keep_nearer(index, t, ids, normals, first, (part.box[0], part.box[1]), *hits)
        for k, index, local, yaw in self._toward(rays, times):
            result = self._moving[k].cast_rays(_tensor(local), nthreads=self.n_threads)
            t, ids, own = (result[key].numpy() for key in ("t_hit", "primitive_ids", "primitive_normals"))
            first = self._first_face[len(self._static) + k]
            keep_nearer(index, t, ids, turned(own, yaw), first, (1.0, 0.0), *hits)
        return hits


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


@njit(cache=True, nogil=True, error_model="numpy")
def _replace(
    hits: Hits, rows: NDArray[np.int64], behind: NDArray[np.float32], again: Hits, rays: NDArray[np.float32]
) -> None:
    """Replace the hits of rays by those behind a pane, with distances from the rays' origins."""
    for k in range(len(rows)):
        i = rows[k]
        travelled = 0.0
        for r in range(3):
            travelled += (behind[k, r] - rays[i, r]) * rays[i, 3 + r]
        hits.distance[i] = travelled + again.distance[k]
        hits.face[i] = again.face[k]
        hits.normal[i] = again.normal[k]

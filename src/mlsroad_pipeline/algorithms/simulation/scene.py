"""What rays meet: the standing street and moving objects, each at its place at the ray's own time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import open3d as o3d
from numba import njit
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.simulation.alignment import interpolate
from mlsroad_pipeline.algorithms.simulation.ground import Ground, ground_height
from mlsroad_pipeline.algorithms.simulation.meshes import GLASS, KIND, Mesh
from mlsroad_pipeline.algorithms.simulation.standing import (
    Standing,
    build_standing,
    casting_structure,
    entering,
    keep_nearer,
)
from mlsroad_pipeline.algorithms.simulation.street import Street
from mlsroad_pipeline.algorithms.simulation.surfaces import Hits, Surfaces, resolve_hits, water_level

_PAST_GLASS = 0.003  # how far behind a pane a ray starts anew, metres
_PANES = 4  # a ray through more panes than this is lost in reflections
_KNOT = 0.01  # moving objects go straight for this long, seconds
_FAR = 100.0  # moving objects farther away than this are not looked at, metres


class Motion(NamedTuple):
    """How something moves along the street.

    Parameters
    ----------
    station, time : float
        Where it is (m) at one moment (s).
    speed : float
        Speed along the alignment, m/s; negative against it.
    offset : float
        Distance to the left of the centre line, metres.
    """

    station: float
    time: float
    speed: float
    offset: float


@dataclass(frozen=True)
class Mover:
    """Something that moves while it is scanned.

    Parameters
    ----------
    label : int
        Taxonomy code of the whole.
    instance : int
        Its number.
    mesh : Mesh
        Faces in its own frame, front along +x, z = 0 on the ground.
    motion : Motion
        Where it is when.
    """

    label: int
    instance: int
    mesh: Mesh
    motion: Motion


class RayScene:
    """A stretch of street that rays can be cast into.

    Parameters
    ----------
    street : Street
        Where moving objects move, and what covers the ground.
    meshes : sequence of Mesh
        What stands still, street-local coordinates.
    instances : sequence of int
        One number per mesh.
    movers : sequence of Mover
        What moves.
    centre : ndarray of shape (3,), float64
        Rays are given relative to this place near them: float32 resolves micrometres there.
    n_threads : int, default 1
        Threads that cast rays; the answers do not depend on it.
    wetness : float, default 0
        Share of paved ground under a film of water.
    standing : sequence of Standing, default ()
        More that stands still, built before; the nearest to the rays first.
    """

    def __init__(
        self, street: Street, meshes: Sequence[Mesh], instances: Sequence[int], movers: Sequence[Mover],
        centre: NDArray[np.float64], *, n_threads: int = 1, wetness: float = 0.0, standing: Sequence[Standing] = (),
    ) -> None:  # fmt: skip
        self.n_threads, self._water = n_threads, water_level(wetness)
        self.street, self.centre, self.movers = street, centre, tuple(movers)
        own = [build_standing(meshes, instances, centre)] if meshes else []
        self._standing = (*own, *standing)
        moving = [np.full(len(m.mesh.faces), m.instance, dtype=np.int32) for m in self.movers]
        self.attributes = np.concatenate(
            [*(part.attributes for part in self._standing), *(m.mesh.attributes for m in self.movers)]
        )
        self.instances = np.concatenate([*(part.instances for part in self._standing), *moving]).astype(np.int32)
        self._moving = [casting_structure(m.mesh.vertices, m.mesh.faces) for m in self.movers]
        counts = [0, *(len(part.instances) for part in self._standing), *(len(m) for m in moving)]
        self._first_face = np.cumsum(counts)
        self._reach = [float(np.sqrt((m.mesh.vertices**2).sum(axis=1).max())) for m in self.movers]

    def cast(
        self, rays: NDArray[np.float32], times: NDArray[np.float64], *, passing: NDArray[np.float32] | None = None
    ) -> Hits:
        """Cast rays and return what each meets first.

        Parameters
        ----------
        rays : ndarray of shape (n, 6), float32
            Origin relative to `centre` and unit direction.
        times : ndarray of shape (n,), float64
            When each ray is sent, seconds.
        passing : ndarray of shape (n,), float32, optional
            A random number in [0, 1) per ray: a ray goes through a pane where it is below the pane's transmission.
            Without it no ray does.

        Returns
        -------
        Hits
            One row per ray.
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
        """Tell which rays meet anything at all; glass counts.

        Parameters
        ----------
        rays : ndarray of shape (n, 6), float32
            Origin relative to `centre` and unit direction.
        times : ndarray of shape (n,), float64
            When each ray is sent, seconds.

        Returns
        -------
        ndarray of shape (n,), bool
            True where something stands or moves in the way.
        """
        blocked = np.zeros(len(rays), dtype=np.bool_)
        limit = np.full(len(rays), np.inf, dtype=np.float32)
        for part in self._standing:
            index, moved = entering(rays, limit, part.box, self.centre - part.centre)
            if len(index):
                blocked[index] |= part.structure.test_occlusions(_tensor(moved), nthreads=self.n_threads).numpy()
        for k, mover in enumerate(self.movers):
            index, local, _ = self._toward(k, mover, rays, times)
            if len(index):
                blocked[index] |= self._moving[k].test_occlusions(_tensor(local), nthreads=self.n_threads).numpy()
        return blocked

    def resolve(self, hits: Hits, rays: NDArray[np.float32]) -> Surfaces:
        """Return what the places are made of that rays met.

        Parameters
        ----------
        hits : Hits
            What `cast` gave.
        rays : ndarray of shape (n, 6), float32
            The rays that it was given.

        Returns
        -------
        Surfaces
            One row per ray, zero where it met nothing.
        """
        street = self.street
        near, _ = street.alignment.locate(self.centre[None, :2])
        return resolve_hits(
            hits.distance, hits.face, rays, self.attributes, self.centre, street.alignment.table,
            street.ground, street.ground_rgb, street.ground_reflectivity, float(near[0]), self._water,
        )  # fmt: skip

    def _toward(
        self, number: int, mover: Mover, rays: NDArray[np.float32], times: NDArray[np.float64]
    ) -> tuple[NDArray[np.int64], NDArray[np.float32], NDArray[np.float32]]:
        if len(rays) == 0:
            return np.zeros(0, np.int64), np.zeros((0, 6), np.float32), np.zeros(0, np.float32)
        first = int(np.floor(times.min() / _KNOT))
        knots = _poses(
            mover.motion, first, int(np.floor(times.max() / _KNOT)) - first + 2, self.centre,
            self.street.alignment.table, self.street.ground,
        )  # fmt: skip
        # What stays farther away than this all the time is not looked at.
        near = np.abs(knots[:, None, :2] - rays[:: max(len(rays) // 16, 1), :2]).max(axis=2).min()
        if near > _FAR:
            return np.zeros(0, np.int64), np.zeros((0, 6), np.float32), np.zeros(0, np.float32)
        return _rays_toward(rays, times, knots, first, self._reach[number])

    def _cast_once(self, rays: NDArray[np.float32], times: NDArray[np.float64]) -> Hits:
        n = len(rays)
        hits = Hits(np.full(n, np.inf, np.float32), np.full(n, -1, np.int32), np.zeros((n, 3), np.float32))
        for part, first in zip(self._standing, self._first_face, strict=False):
            index, moved = entering(rays, hits.distance, part.box, self.centre - part.centre)
            if len(index) == 0:
                continue
            answer = part.structure.cast_rays(_tensor(moved), nthreads=self.n_threads)
            t, ids, normals = (answer[key].numpy() for key in ("t_hit", "primitive_ids", "primitive_normals"))
            keep_nearer(index, t, ids, normals, first, *hits)
        for k, mover in enumerate(self.movers):
            index, local, yaw = self._toward(k, mover, rays, times)
            if len(index) == 0:
                continue
            answer = self._moving[k].cast_rays(_tensor(local), nthreads=self.n_threads)
            t, ids, own = (answer[key].numpy() for key in ("t_hit", "primitive_ids", "primitive_normals"))
            c, s = np.cos(yaw), np.sin(yaw)
            normals = np.stack([c * own[:, 0] - s * own[:, 1], s * own[:, 0] + c * own[:, 1], own[:, 2]], axis=1)
            keep_nearer(index, t, ids, normals, self._first_face[len(self._standing) + k], *hits)
        return hits


def _tensor(rays: NDArray[np.float32]) -> o3d.core.Tensor:
    return o3d.core.Tensor.from_numpy(rays)


@njit(cache=True, nogil=True)
def _through_panes(
    rays: NDArray[np.float32], rows: NDArray[np.int64], cast: NDArray[np.float32], hits: Hits,
    attributes: NDArray[np.float32], passing: NDArray[np.float32],
) -> tuple[NDArray[np.int64], NDArray[np.float32]]:  # fmt: skip
    """Return which of some rays go on behind the pane that they met, and those rays from there on."""
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


@njit(cache=True, nogil=True)
def _replace(
    hits: Hits, rows: NDArray[np.int64], behind: NDArray[np.float32], again: Hits, rays: NDArray[np.float32]
) -> None:
    """Enter what rays met behind a pane, its distance counted from where the rays begin."""
    for k in range(len(rows)):
        i = rows[k]
        travelled = 0.0
        for r in range(3):
            travelled += (behind[k, r] - rays[i, r]) * rays[i, 3 + r]
        hits.distance[i] = travelled + again.distance[k]
        hits.face[i] = again.face[k]
        hits.normal[i] = again.normal[k]


@njit(cache=True, nogil=True)
def _poses(
    motion: Motion, first: int, count: int, centre: NDArray[np.float64], table: NDArray[np.float64], ground: Ground
) -> NDArray[np.float64]:
    """Return x, y, z relative to the centre and heading of a moving object at `count` knots of time."""
    knots = np.empty((count, 4))
    for k in range(count):
        s = motion.station + motion.speed * ((first + k) * _KNOT - motion.time)
        x, y, heading = interpolate(table, ground.start, s)
        knots[k, 0] = x - motion.offset * np.sin(heading) - centre[0]
        knots[k, 1] = y + motion.offset * np.cos(heading) - centre[1]
        knots[k, 2] = ground_height(s, motion.offset, ground) - centre[2]
        knots[k, 3] = heading + (np.pi if motion.speed < 0 else 0.0)
    return knots


@njit(cache=True, nogil=True)
def _rays_toward(
    rays: NDArray[np.float32], times: NDArray[np.float64], knots: NDArray[np.float64], first: int, reach: float
) -> tuple[NDArray[np.int64], NDArray[np.float32], NDArray[np.float32]]:
    """Return the rays that pass within `reach` of a moving object, in its own frame at their times."""
    n = 0
    index = np.empty(len(rays), dtype=np.int64)
    local = np.empty((len(rays), 6), dtype=np.float32)
    yaw = np.empty(len(rays), dtype=np.float32)
    for i in range(len(rays)):
        u = times[i] / _KNOT - first
        k = min(int(u), len(knots) - 2)
        f = u - k
        px = rays[i, 0] - (knots[k, 0] + f * (knots[k + 1, 0] - knots[k, 0]))
        py = rays[i, 1] - (knots[k, 1] + f * (knots[k + 1, 1] - knots[k, 1]))
        pz = rays[i, 2] - (knots[k, 2] + f * (knots[k + 1, 2] - knots[k, 2]))
        dx, dy, dz = rays[i, 3], rays[i, 4], rays[i, 5]
        along = -(px * dx + py * dy + pz * dz)
        squared = px * px + py * py + pz * pz
        if squared - along * along > reach * reach or (along < 0 and squared > reach * reach):
            continue
        heading = knots[k, 3] + f * (knots[k + 1, 3] - knots[k, 3])
        c, sn = np.cos(heading), np.sin(heading)
        index[n], yaw[n] = i, heading
        local[n, 0], local[n, 1], local[n, 2] = c * px + sn * py, c * py - sn * px, pz
        local[n, 3], local[n, 4], local[n, 5] = c * dx + sn * dy, c * dy - sn * dx, dz
        n += 1
    return index[:n], local[:n], yaw[:n]

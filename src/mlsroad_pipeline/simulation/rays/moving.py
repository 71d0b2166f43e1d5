"""Moving objects, and the rays near them at each ray's own time."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mlsroad_pipeline.simulation.model.compiled import leaf
from mlsroad_pipeline.simulation.model.meshes import Mesh
from mlsroad_pipeline.simulation.street.alignment import interpolate
from mlsroad_pipeline.simulation.street.ground import Ground, ground_height

KNOT = 0.01  # Time step of straight motion of moving objects, seconds
FAR = 100.0  # Range beyond which moving objects are ignored, metres
_BUNDLE = 16  # rays that are tested together
_LAG = 1.0  # bound on an object's way during a bundle and between two knots, metres


class Motion(NamedTuple):
    """Motion of an object along the street."""

    # station, time: its station (m) at one moment (s)
    station: float
    time: float
    speed: float  # Speed along the alignment, m/s; negative against it
    offset: float  # Distance to the left of the centre line, metres


@dataclass(frozen=True)
class Mover:
    """Object that moves while it is scanned."""

    label: int  # Taxonomy code of the whole
    instance: int  # Instance number
    mesh: Mesh  # Faces in its own frame, front along +x, z = 0 on the ground
    motion: Motion  # Its motion
    design: str = ""  # Name of its design


@leaf
def _poses(
    motion: NDArray[np.float64], first: int, centre: NDArray[np.float64], table: NDArray[np.float64], ground: Ground,
    knots: NDArray[np.float64],
) -> None:  # fmt: skip
    """Write x, y, z relative to the centre and heading of a moving object at knots of time."""
    for k in range(len(knots)):
        s = motion[0] + motion[2] * ((first + k) * KNOT - motion[1])
        x, y, heading = interpolate(table, ground.start, s)
        knots[k, 0] = x - motion[3] * np.sin(heading) - centre[0]
        knots[k, 1] = y + motion[3] * np.cos(heading) - centre[1]
        knots[k, 2] = ground_height(s, motion[3], ground) - centre[2]
        knots[k, 3] = heading + (np.pi if motion[2] < 0 else 0.0)


@leaf
def _is_near(knots: NDArray[np.float64], rays: NDArray[np.float32]) -> bool:
    """Return whether an object comes within `FAR` of the origins of some of the rays."""
    for i in range(0, len(rays), max(len(rays) // 8, 1)):
        for k in (0, len(knots) // 2, len(knots) - 1):
            if max(abs(knots[k, 0] - rays[i, 0]), abs(knots[k, 1] - rays[i, 1])) <= FAR:
                return True
    return False


@njit(cache=True, nogil=True, error_model="numpy")
def _bundles(rays: NDArray[np.float32]) -> NDArray[np.float64]:
    """Return origin, axis, cosine and sine of the angle, and spread of origins of a cone around each `_BUNDLE` rays."""
    out = np.empty(((len(rays) + _BUNDLE - 1) // _BUNDLE, 9))
    for b in range(len(out)):
        first, last = b * _BUNDLE, min((b + 1) * _BUNDLE, len(rays))
        for c in range(6):
            total = 0.0
            for i in range(first, last):
                total += rays[i, c]
            out[b, c] = total / (last - first)
        length = max(np.sqrt(out[b, 3] ** 2 + out[b, 4] ** 2 + out[b, 5] ** 2), 1e-9)
        least, apart = 1.0, 0.0
        for i in range(first, last):
            along, gap = 0.0, 0.0
            for c in range(3):
                along += rays[i, 3 + c] * out[b, 3 + c] / length
                gap += (rays[i, c] - out[b, c]) ** 2
            least, apart = min(least, along), max(apart, gap)
        for c in range(3, 6):
            out[b, c] /= length
        angle = np.arccos(max(least, -1.0)) + 1e-3
        out[b, 6], out[b, 7], out[b, 8] = np.cos(angle), np.sin(angle), np.sqrt(apart)
    return out


@leaf
def _misses(bundle: NDArray[np.float64], pose: NDArray[np.float64], reach: float) -> bool:
    """Return whether no ray of a bundle comes within reach of a place."""
    x, y, z = pose[0] - bundle[0], pose[1] - bundle[1], pose[2] - bundle[2]
    squared, reach = x * x + y * y + z * z, reach + bundle[8] + _LAG
    if squared <= reach * reach:
        return False
    # The place is farther off the axis than the angles of the cone and of the place together.
    along = x * bundle[3] + y * bundle[4] + z * bundle[5]
    return bool(along < bundle[6] * np.sqrt(squared - reach * reach) - bundle[7] * reach)


@njit(cache=True, nogil=True, error_model="numpy")
def rays_toward(
    rays: NDArray[np.float32], times: NDArray[np.float64], motions: NDArray[np.float64], reaches: NDArray[np.float64],
    centre: NDArray[np.float64], table: NDArray[np.float64], ground: Ground,
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float32], NDArray[np.float32]]:  # fmt: skip
    """Return the rays within reach of each moving object, in its own frame at their times.

    Returns CSR row pointers per object, rows of the rays, the rays, and the object's heading at their times.
    """
    indptr, n = np.zeros(len(motions) + 1, np.int64), 0
    index, local = np.empty(1024, np.int64), np.empty((1024, 6), np.float32)
    yaw = np.empty(1024, np.float32)
    if len(rays) == 0 or len(motions) == 0:
        return indptr, index[:0], local[:0], yaw[:0]
    first = int(np.floor(times.min() / KNOT))
    knots = np.empty((int(np.floor(times.max() / KNOT)) - first + 2, 4))
    bundles, missed = _bundles(rays), False
    for m in range(len(motions)):
        _poses(motions[m], first, centre, table, ground, knots)
        reach = reaches[m]
        for i in range(len(rays) if _is_near(knots, rays) else 0):
            u = times[i] / KNOT - first
            if i % _BUNDLE == 0:
                last = min(i + _BUNDLE, len(rays)) - 1
                # The rays of a bundle may be seconds apart.
                close = abs(times[last] - times[i]) < KNOT
                missed = close and _misses(bundles[i // _BUNDLE], knots[min(int(u), len(knots) - 1)], reach)
            if missed:
                continue
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
            if n == len(index):
                index = np.concatenate((index, index))
                local, yaw = np.concatenate((local, local)), np.concatenate((yaw, yaw))
            heading = knots[k, 3] + f * (knots[k + 1, 3] - knots[k, 3])
            c, s = np.cos(heading), np.sin(heading)
            index[n], yaw[n] = i, heading
            local[n, 0], local[n, 1], local[n, 2] = c * px + s * py, c * py - s * px, pz
            local[n, 3], local[n, 4], local[n, 5] = c * dx + s * dy, c * dy - s * dx, dz
            n += 1
        indptr[m + 1] = n
    return indptr, index[:n].copy(), local[:n].copy(), yaw[:n].copy()


@njit(cache=True, nogil=True, error_model="numpy")
def turned(normals: NDArray[np.float32], yaw: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return vectors rotated about z, each by its own angle."""
    out = np.empty_like(normals)
    for i in range(len(normals)):
        c, s = np.cos(yaw[i]), np.sin(yaw[i])
        out[i, 0] = c * normals[i, 0] - s * normals[i, 1]
        out[i, 1] = s * normals[i, 0] + c * normals[i, 1]
        out[i, 2] = normals[i, 2]
    return out

"""Reception of pulses: extra rays at edges and mirrors, and the measured returns."""

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY
from mlsroad_pipeline.simulation.model.meshes import FOLIAGE, GLASS, KIND
from mlsroad_pipeline.simulation.parameters.devices import Device
from mlsroad_pipeline.simulation.parameters.presets import SimulationParameters
from mlsroad_pipeline.simulation.rays.scene import RayScene
from mlsroad_pipeline.simulation.rays.surfaces import WET, Hits, Surfaces
from mlsroad_pipeline.simulation.scanning.amplitudes import mirrored_share, power_of
from mlsroad_pipeline.simulation.scanning.echoes import Echoes, Receiver, Slots, measure, ray_echoes
from mlsroad_pipeline.simulation.scanning.scanner import Pulses

GHOST = TAXONOMY["outlier"]  # Label of returns by way of a mirror, whose measured places are empty
_OFF_MIRROR = 0.003  # offset of a reflected ray's origin from the mirror, metres
_APART = 0.12  # rays of one beam with ranges farther apart hit different surfaces, metres


class Returns(NamedTuple):
    """Measured returns, in the order of the pulses."""

    pulse: NDArray[np.int64]  # Row of the pulse
    distance: NDArray[np.float64]  # Measured range, metres
    # 0 to 1: amplitude over `FULL_SCALE_DB` with a soft limit, reflectance where the device corrects it, or amplitude
    # on the device's own scale
    intensity: NDArray[np.float32]
    face: NDArray[np.int32]  # Face that contributed most to the return
    normal: NDArray[np.float32]  # Its unit normal
    # number, total: return number, and number of returns of its pulse
    number: NDArray[np.uint8]
    total: NDArray[np.uint8]


def receive(
    scene: RayScene, pulses: Pulses, parameters: SimulationParameters, rng: np.random.Generator, *, scanner: int = 0
) -> tuple[Returns, Surfaces]:
    """Cast the pulses of a scanner into a scene; return the noisy returns and their surfaces."""
    device = parameters.devices[scanner]
    n = len(pulses.time)
    chance = rng.random((n, 2), dtype=np.float32)
    noise = rng.standard_normal((n, 3), dtype=np.float32)
    hits = scene.cast(pulses.rays, pulses.time, passing=chance[:, 0])
    central = scene.resolve(hits, pulses.rays)
    slots, rays, extra = _extra_rays(scene, pulses, hits, central, parameters.beam_rays, device, chance, rng)
    around = scene.resolve(extra, rays)
    receiver = _receiver(device)
    of_centre = ray_echoes(hits, central, pulses.rays, device.sensitivity, device.turf_gain)
    of_extra = ray_echoes(extra, around, rays, device.sensitivity, device.turf_gain)
    _by_mirror(slots.ghost, of_centre, of_extra, hits, pulses.rays, around)
    power = power_of(device, pulses.time, of_centre.amplitude, seed=parameters.seed, scanner=scanner)
    pulse, distance, intensity, source, number, total = measure(
        of_centre, central.kind, of_extra, slots, power, chance[:, 1], noise, receiver
    )
    # Face and surface are those of the ray that contributed most to each return.
    inner, aside = np.minimum(source, n - 1), np.flatnonzero(source >= n)

    def chosen(first: Any, second: Any) -> NDArray:
        column: NDArray = first[inner]
        column[aside] = second[source[aside] - n]
        return column

    face, normal = chosen(hits.face, extra.face), chosen(hits.normal, extra.normal)
    surfaces = Surfaces(*(chosen(*columns) for columns in zip(central, around, strict=True)))
    return Returns(pulse, distance, intensity, face, normal, number, total), surfaces


def _receiver(device: Device) -> Receiver:
    return Receiver(
        device.min_range, device.max_range, device.range_noise, device.range_step, device.pulse_length,
        device.sensitivity, device.blooming, device.divergence, device.step, device.dropout,
        len(device.elevations), device.max_returns, device.corrected, *(device.intensity_scale or (0.0, 0.0)),
    )  # fmt: skip


def _extra_rays(
    scene: RayScene, pulses: Pulses, hits: Hits, central: Surfaces, beam_rays: int, device: Device,
    chance: NDArray[np.float32], rng: np.random.Generator,
) -> tuple[Slots, NDArray[np.float32], Hits]:  # fmt: skip
    """Cast a second ray where a profile is not plane, more rays where it hits something else, and mirrored ones."""
    n, spot = len(pulses.time), device.divergence / 2
    edges, mores, ghosts = (np.full(n, -1, np.int64) for _ in range(3))
    slots = Slots(edges, mores, ghosts, max(beam_rays - 2, 0))
    edge = _NONE
    if beam_rays > 1:
        edge = _may_mix(hits.distance, device.max_range, len(device.elevations), int(spot / device.step))
    rays = [_tilted(pulses.rays, edge, rng.random((len(edge), 2), dtype=np.float32), spot)]
    cast = [scene.cast(rays[0], pulses.time[edge], passing=chance[edge, 0])]
    slots.edge[edge] = np.arange(len(edge))
    apart = edge[_differ(edge, hits, cast[0], scene.attributes)] if slots.n_more else _NONE
    slots.more[apart] = len(edge) + slots.n_more * np.arange(len(apart))
    again = np.repeat(apart, slots.n_more)
    rays.append(_tilted(pulses.rays, again, rng.random((len(again), 2), dtype=np.float32), spot))
    cast.append(scene.cast(rays[1], pulses.time[again], passing=chance[again, 0]))
    mirror, mirrored = _mirrored(pulses.rays, hits, central.kind)
    slots.ghost[mirror] = len(edge) + len(again) + np.arange(len(mirror))
    rays.append(mirrored)
    cast.append(scene.cast(mirrored, pulses.time[mirror]))
    extra = Hits(*(np.concatenate(columns) for columns in zip(*cast, strict=True)))
    return slots, np.concatenate(rays), extra


_NONE = np.zeros(0, np.int64)


@njit(cache=True, nogil=True, error_model="numpy")
def _may_mix(distance: NDArray[np.float32], max_range: float, beams: int, reach: int) -> NDArray[np.int64]:
    """Return the pulses within `reach` of an edge: on a plane the inverse range is a sinusoid of the angle."""
    n = len(distance)
    marked = np.zeros(n, np.bool_)
    for i in range(beams, n - beams):
        before, here, after = 1 / distance[i - beams], 1 / distance[i], 1 / distance[i + beams]
        level = max(before, here, after)
        if level > 1 / max_range and abs(before - 2 * here + after) > 0.004 * level:
            for k in range(-reach, reach + 1):
                marked[min(max(i + k * beams, 0), n - 1)] = True
    return np.flatnonzero(marked)


def _differ(edge: NDArray[np.int64], hits: Hits, aside: Hits, attributes: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Return where the second ray shows that the beam hits more than one surface, or partly none."""
    a, b = hits.face[edge], aside.face
    with np.errstate(invalid="ignore"):  # both rays may miss
        apart = np.abs(hits.distance[edge] - aside.distance).astype(np.float64) > _APART
    leaves = (a >= 0) & (a != b) & (attributes[a, KIND] == FOLIAGE)
    return np.where((a >= 0) & (b >= 0), apart, (a >= 0) | (b >= 0)) | leaves


@njit(cache=True, nogil=True, error_model="numpy")
def _tilted(
    rays: NDArray[np.float32], rows: NDArray[np.int64], chance: NDArray[np.float32], angle: float
) -> NDArray[np.float32]:
    """Return rays tilted to random places of the outer three quarters of the beam's cross-section."""
    out = np.empty((len(rows), 6), np.float32)
    for k in range(len(rows)):
        x, y, z = rays[rows[k], 3], rays[rows[k], 4], rays[rows[k], 5]
        # Two axes across the direction, of unit length.
        if abs(z) < 0.9:
            length = np.sqrt(x * x + y * y)
            ux, uy, uz = y / length, -x / length, 0.0
        else:
            length = np.sqrt(y * y + z * z)
            ux, uy, uz = 0.0, z / length, -y / length
        vx, vy, vz = y * uz - z * uy, z * ux - x * uz, x * uy - y * ux
        around, away = 2 * np.pi * chance[k, 0], angle * np.sqrt(0.25 + 0.75 * chance[k, 1])
        a, b = away * np.cos(around), away * np.sin(around)
        for r in range(3):
            out[k, r] = rays[rows[k], r]
        out[k, 3], out[k, 4], out[k, 5] = x + a * ux + b * vx, y + a * uy + b * vy, z + a * uz + b * vz
    return out


def _mirrored(
    rays: NDArray[np.float32], hits: Hits, kind: NDArray[np.uint8]
) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """Return the rays reflected by panes or water, and the rows of their pulses."""
    rows = np.flatnonzero((hits.face >= 0) & ((kind == GLASS) | (kind == WET)))
    along = _along(rays[rows], hits.normal[rows])
    seen = (kind[rows] == GLASS) | (np.abs(along) <= 0.35)
    rows, along = rows[seen], along[seen]
    at, way = np.split(rays[rows], 2, axis=1)
    out = np.empty((len(rows), 6), np.float32)
    out[:, 3:] = way - (2 * along)[:, None] * hits.normal[rows]
    out[:, :3] = (at + hits.distance[rows, None] * way) + _OFF_MIRROR * out[:, 3:].astype(np.float64)
    return rows, out


def _along(rays: NDArray[np.float32], normals: NDArray[np.float32]) -> NDArray[np.float64]:
    """Return the cosines between rays and unit normals."""
    return np.asarray((rays[:, 3:] * normals).sum(axis=1, dtype=np.float64))


@njit(cache=True, nogil=True, error_model="numpy")
def _by_mirror(
    ghost: NDArray[np.int64], central: Echoes, extra: Echoes, hits: Hits, rays: NDArray[np.float32],
    surfaces: Surfaces,
) -> None:  # fmt: skip
    """Place the hits of mirrored rays behind the mirror as ghosts: a longer path, and a loss per reflection."""
    for i in range(len(ghost)):
        e = ghost[i]
        if e < 0 or not np.isfinite(extra.distance[e]):
            continue
        cosine = 0.0
        for r in range(3):
            cosine += hits.normal[i, r] * rays[i, 3 + r]
        there, beyond = float(central.distance[i]), float(extra.distance[e]) + _OFF_MIRROR
        loss = 20 * np.log10(mirrored_share(abs(cosine)))
        near, far = np.sqrt(beyond * beyond + 16.0), np.sqrt((there + beyond) ** 2 + 16.0)
        extra.amplitude[e] += loss + 20 * np.log10(near / far)
        extra.distance[e] = there + beyond
        surfaces.label[e] = GHOST

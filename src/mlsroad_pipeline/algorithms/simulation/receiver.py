"""The scanners' receivers: ranges with noise, mixed pixels, multiple returns, amplitudes and drop-outs."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.simulation.meshes import GLASS, PAINT, RETRO
from mlsroad_pipeline.algorithms.simulation.presets import SimulationParameters
from mlsroad_pipeline.algorithms.simulation.scanner import Pulses
from mlsroad_pipeline.algorithms.simulation.scene import RayScene
from mlsroad_pipeline.algorithms.simulation.surfaces import Hits, Surfaces

FULL_SCALE_DB = 50.0
"""Amplitude that is intensity 1, decibels above one photon-starved unit."""

THRESHOLD_DB = 4.0
"""Amplitude at which half of the returns are detected, decibels."""

RESOLUTION = 0.6
"""Two surfaces nearer to each other than this along one pulse give one mixed return, metres (4 ns)."""

_MIN_RANGE = 1.2  # nearer returns are the van's own, metres


class Returns(NamedTuple):
    """What came back, in the order of the pulses.

    Parameters
    ----------
    pulse : ndarray of shape (m,), int64
        Row of the pulse.
    distance : ndarray of shape (m,), float64
        Measured range, metres.
    intensity : ndarray of shape (m,), float32
        Amplitude over `FULL_SCALE_DB`, 0 to 1.
    face : ndarray of shape (m,), int32
        Face that gave most of the return.
    normal : ndarray of shape (m, 3), float32
        Its unit normal.
    number, total : ndarray of shape (m,), uint8
        Return number, and number of returns of its pulse.
    """

    pulse: NDArray[np.int64]
    distance: NDArray[np.float64]
    intensity: NDArray[np.float32]
    face: NDArray[np.int32]
    normal: NDArray[np.float32]
    number: NDArray[np.uint8]
    total: NDArray[np.uint8]


def receive(
    scene: RayScene, pulses: Pulses, parameters: SimulationParameters, rng: np.random.Generator
) -> tuple[Returns, Surfaces]:
    """Cast pulses into a scene and measure what comes back.

    Parameters
    ----------
    scene : RayScene
        What there is to hit.
    pulses : Pulses
        The pulses.
    parameters : SimulationParameters
        Noise, divergence and range.
    rng : numpy.random.Generator
        Source of all noise.

    Returns
    -------
    returns : Returns
        In the order of the pulses.
    surfaces : Surfaces
        Of each return.
    """
    n = len(pulses.time)
    chance = rng.random((n, 4), dtype=np.float32)
    noise = rng.standard_normal((n, 4), dtype=np.float32)
    hits = scene.cast(pulses.rays, pulses.time, passing=chance[:, 0])
    edge = np.flatnonzero(_may_mix(hits.distance, parameters.max_range))
    aside = pulses.rays[edge]
    aside[:, 3:] = _tilted(aside[:, 3:], chance[edge, 1:3], parameters.beam_divergence / 2)
    edge_hits = scene.cast(aside, pulses.time[edge], passing=chance[edge, 0])
    central, peripheral = scene.resolve(hits, pulses.rays), scene.resolve(edge_hits, aside)
    slot = np.full(n, -1, dtype=np.int64)
    slot[edge] = np.arange(len(edge))
    settings = (parameters.max_range, parameters.range_noise)
    pulse, distance, intensity, second, number, total = _measure(
        hits, central, pulses.rays, edge_hits, peripheral, aside, slot, chance[:, 3], noise, settings
    )
    rows = np.flatnonzero(second)
    theirs = slot[pulse[rows]]

    def pick(of_centre: NDArray, of_edge: NDArray) -> NDArray:
        chosen = of_centre[pulse]
        chosen[rows] = of_edge[theirs]
        return chosen

    face, normal = pick(hits.face, edge_hits.face), pick(hits.normal, edge_hits.normal)
    surfaces = Surfaces(
        pick(central.label, peripheral.label), pick(central.kind, peripheral.kind), pick(central.rgb, peripheral.rgb),
        pick(central.reflectivity, peripheral.reflectivity), pick(central.relief, peripheral.relief),
    )  # fmt: skip
    return Returns(pulse, distance, intensity, face, normal, number, total), surfaces


def range_deviation(range_noise: float, amplitude: float) -> float:
    """Return the standard deviation of a measured range.

    Parameters
    ----------
    range_noise : float
        That of a strong return, metres.
    amplitude : float
        Of the return, decibels.

    Returns
    -------
    float
        ``range_noise * sqrt(1 + 10 ** ((14 - amplitude) / 10))``, metres.
    """
    return float(_deviation(range_noise, amplitude))


@njit(cache=True, nogil=True)
def _deviation(range_noise: float, amplitude: float) -> float:
    return range_noise * np.sqrt(1.0 + 10.0 ** ((14.0 - amplitude) / 10.0))


@njit(cache=True, nogil=True)
def _may_mix(distance: NDArray[np.float32], max_range: float) -> NDArray[np.bool_]:
    """Tell which pulses pass near an edge: on a plane the inverse range is a sinusoid of the angle."""
    n = len(distance)
    mask = np.zeros(n, dtype=np.bool_)
    for i in range(1, n - 1):
        before, here, after = 1 / distance[i - 1], 1 / distance[i], 1 / distance[i + 1]
        level = max(before, here, after)
        mask[i] = level > 1 / max_range and abs(before - 2 * here + after) > 0.004 * level
    return mask


@njit(cache=True, nogil=True)
def _tilted(directions: NDArray[np.float32], chance: NDArray[np.float32], angle: float) -> NDArray[np.float32]:
    """Turn directions to a random place of the outer half of the beam's cross-section."""
    out = np.empty_like(directions)
    for i in range(len(directions)):
        d = directions[i].astype(np.float64)
        up = np.array([0.0, 0.0, 1.0]) if abs(d[2]) < 0.9 else np.array([1.0, 0.0, 0.0])
        u = np.array([d[1] * up[2] - d[2] * up[1], d[2] * up[0] - d[0] * up[2], d[0] * up[1] - d[1] * up[0]])
        u /= np.sqrt((u * u).sum())
        v = np.array([d[1] * u[2] - d[2] * u[1], d[2] * u[0] - d[0] * u[2], d[0] * u[1] - d[1] * u[0]])
        around, away = 2 * np.pi * chance[i, 0], angle * np.sqrt(0.25 + 0.75 * chance[i, 1])
        out[i] = d + away * (np.cos(around) * u + np.sin(around) * v)
    return out


@njit(cache=True, nogil=True)
def _amplitude(reflectivity: float, kind: int, cosine: float, distance: float) -> float:
    """Return the amplitude of a return in decibels: Lambert, the inverse square, gloss and retro-reflection."""
    slant = np.degrees(np.arccos(min(cosine, 1.0)))
    # Closer than some metres the receiver does not see the whole spot.
    effective = np.sqrt(distance * distance + 16.0)
    decibels = 38.0 + 10 * np.log10(max(reflectivity * max(cosine, 0.02), 1e-6)) - 20 * np.log10(effective / 10.0)
    if kind == RETRO:
        decibels += 17.0 * np.exp(-((slant / 35.0) ** 2))
    elif kind == PAINT:
        decibels += 9.0 * np.exp(-((slant / 9.0) ** 2)) - 2.0
    elif kind == GLASS:
        decibels += 10.0 * np.exp(-((slant / 4.0) ** 2)) - 14.0
    return decibels


@njit(cache=True, nogil=True)
def _answer(
    i: int, hits: Hits, surfaces: Surfaces, rays: NDArray[np.float32], share: float
) -> tuple[float, float]:  # fmt: skip
    """Return range and amplitude of one ray's hit that has a share of the beam's energy."""
    normal = hits.normal[i]
    cosine = abs(normal[0] * rays[i, 3] + normal[1] * rays[i, 4] + normal[2] * rays[i, 5])
    shortened = min(surfaces.relief[i] / max(cosine, 0.12), 0.4)
    distance = float(hits.distance[i]) - shortened
    amplitude = _amplitude(surfaces.reflectivity[i], int(surfaces.kind[i]), cosine, distance)
    return distance, amplitude + 10 * np.log10(share)


@njit(cache=True, nogil=True)
def _measure(
    hits: Hits, central: Surfaces, rays: NDArray[np.float32], edge_hits: Hits, peripheral: Surfaces,
    aside: NDArray[np.float32], slot: NDArray[np.int64], chance: NDArray[np.float32], noise: NDArray[np.float32],
    settings: tuple[float, float],
) -> tuple[NDArray, NDArray, NDArray, NDArray, NDArray, NDArray]:  # fmt: skip
    max_range, range_noise = settings
    n = len(slot)
    pulse, distance = np.empty(2 * n, np.int64), np.empty(2 * n)
    intensity, second = np.empty(2 * n, np.float32), np.empty(2 * n, np.bool_)
    number, total = np.empty(2 * n, np.uint8), np.empty(2 * n, np.uint8)
    m = 0
    for i in range(n):
        e = slot[i]
        share = 0.2 + 0.35 * chance[i] if e >= 0 else 0.0
        ra, rb = np.inf, np.inf
        aa, ab = -99.0, -99.0
        if hits.face[i] >= 0:
            ra, aa = _answer(i, hits, central, rays, 1.0 - share)
        if e >= 0 and edge_hits.face[e] >= 0:
            rb, ab = _answer(e, edge_hits, peripheral, aside, share)
        if abs(ra - rb) < RESOLUTION:
            pa, pb = 10.0 ** (aa / 10), 10.0 ** (ab / 10)
            ra, aa = (pa * ra + pb * rb) / (pa + pb), 10 * np.log10(pa + pb)
            swapped = pb > pa
            rb = np.inf
        else:
            swapped = rb < ra
            if swapped:
                ra, rb, aa, ab = rb, ra, ab, aa
        first = m
        for k in range(2):
            r, a = (ra, aa) if k == 0 else (rb, ab)
            if not (_MIN_RANGE < r < max_range):
                continue
            # Detection fails softly around the threshold, and rarely anywhere.
            needed = THRESHOLD_DB + 1.2 * noise[i, 2 + k]
            if a < needed or (chance[i] * 977.0) % 1.0 < 0.002:
                continue
            pulse[m] = i
            distance[m] = r + _deviation(range_noise, a) * noise[i, k]
            intensity[m] = min(max((a + 0.4 * noise[i, 3 - k]) / FULL_SCALE_DB, 0.0), 1.0)
            second[m] = swapped if k == 0 else not swapped
            number[m] = m - first + 1
            m += 1
        total[first:m] = m - first
    return pulse[:m], distance[:m], intensity[:m], second[:m], number[:m], total[:m]

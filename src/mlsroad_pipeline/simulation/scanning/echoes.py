"""Echoes of one pulse: mixed ranges, detection, blooming."""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mlsroad_pipeline.simulation.model.compiled import leaf
from mlsroad_pipeline.simulation.model.meshes import GROUND, RETRO
from mlsroad_pipeline.simulation.rays.surfaces import Hits, Surfaces
from mlsroad_pipeline.simulation.scanning.amplitudes import (
    SATURATION_DB,
    Power,
    amplitude_of,
    intensity_of,
    range_deviation,
)
from mlsroad_pipeline.simulation.street.ground import GRASS

THRESHOLD_DB = 4.0  # Amplitude at which half of the returns are detected, decibels
GLARE_LOSS_DB = 20.0  # Loss from a saturated return to its blooming on the adjacent pulse, decibels
_MOST = 20  # echoes of one pulse before they mix


class Receiver(NamedTuple):
    """Properties of a device that `measure` uses; see `Device`."""

    min_range: float  # Fields and properties of `Device`
    max_range: float  # Fields and properties of `Device`
    # range_noise, range_step, pulse_length, sensitivity, blooming, divergence, step: fields and properties of `Device`
    range_noise: float
    range_step: float
    pulse_length: float
    sensitivity: float
    blooming: float
    divergence: float
    step: float
    dropout: float  # Share of returns that are lost
    # beams, max_returns: numbers of beams and of returns kept
    beams: int
    max_returns: int
    corrected: bool  # Whether intensity is reflectance
    # dark, bright: amplitudes of `Device.intensity_scale`; both 0 without it
    dark: float
    bright: float


class Slots(NamedTuple):
    """Rays that sample a pulse's beam beside the central one."""

    edge: NDArray[np.int64]  # Row of the pulse's second ray among the extra rays, or -1
    more: NDArray[np.int64]  # Row of the first of `n_more` further ones, or -1
    ghost: NDArray[np.int64]  # Row of the ray reflected by a mirror, or -1
    n_more: int  # See `more`


@leaf
def _recorded(amplitude: float, distance: float, gain: float, receiver: Receiver) -> float:
    """Return the recorded intensity of a return as this device scales it."""
    if receiver.bright > receiver.dark:
        return min(max((amplitude + gain - receiver.dark) / (receiver.bright - receiver.dark), 0.0), 1.0)
    return intensity_of(amplitude + gain - receiver.sensitivity, distance, receiver.corrected)


class Echoes(NamedTuple):
    """Echo of each ray, before the echoes of a pulse mix."""

    distance: NDArray[np.float32]  # Range, metres; infinite without a hit
    amplitude: NDArray[np.float32]  # At full power, decibels; -99 without a hit
    tangent: NDArray[np.float32]  # Tangent of the angle of incidence


@njit(cache=True, nogil=True, error_model="numpy")
def ray_echoes(
    hits: Hits, surfaces: Surfaces, rays: NDArray[np.float32], sensitivity: float, turf_gain: float
) -> Echoes:
    """Return the echo of each ray."""
    n = len(hits.face)
    distance, amplitude = np.full(n, np.inf, np.float32), np.full(n, -99.0, np.float32)
    tangent = np.zeros(n, np.float32)
    for i in range(n):
        if hits.face[i] < 0:
            continue
        cosine = 0.0
        for r in range(3):
            cosine += hits.normal[i, r] * rays[i, 3 + r]
        cosine = min(abs(cosine), 1.0)
        # Blades of grass and clods rise above the ground's mesh.
        shortened = min(surfaces.relief[i] / max(cosine, 0.12), 0.4)
        distance[i] = hits.distance[i] - shortened
        amplitude[i] = sensitivity + amplitude_of(surfaces.reflectivity[i], int(surfaces.kind[i]), cosine, distance[i])
        if turf_gain != 0.0 and surfaces.label[i] == GRASS and surfaces.kind[i] == GROUND:
            amplitude[i] += turf_gain
        tangent[i] = np.sqrt(1.0 - cosine * cosine) / max(cosine, 0.1)
    return Echoes(distance, amplitude, tangent)


@leaf
def _mix(
    count: int, length: float, r: NDArray[np.float64], a: NDArray[np.float64], source: NDArray[np.int64],
    slant: NDArray[np.float64],
) -> int:  # fmt: skip
    """Sort echoes by range, mix those within a pulse length, in place, and return how many remain."""
    for k in range(1, count):
        for j in range(k, 0, -1):
            if r[j - 1] <= r[j]:
                break
            r[j - 1], r[j] = r[j], r[j - 1]
            a[j - 1], a[j] = a[j], a[j - 1]
            source[j - 1], source[j] = source[j], source[j - 1]
            slant[j - 1], slant[j] = slant[j], slant[j - 1]
    kept, k = 0, 0
    while k < count:
        first, power, weighted, strongest = r[k], 0.0, 0.0, k
        j = k
        while j < count and r[j] - first < length:
            p = 10.0 ** (a[j] / 10.0)
            power += p
            weighted += p * r[j]
            if a[j] > a[strongest]:
                strongest = j
            j += 1
        origin, angle = source[strongest], slant[strongest]
        r[kept], a[kept], source[kept], slant[kept] = weighted / power, 10.0 * np.log10(power), origin, angle
        kept += 1
        k = j
    return kept


@leaf
def _strongest(count: int, most: int, r: NDArray, a: NDArray, source: NDArray, slant: NDArray) -> int:
    """Keep the strongest echoes, in place and in order, and return their number."""
    while count > most:
        weakest = 0
        for k in range(1, count):
            if a[k] < a[weakest]:
                weakest = k
        for k in range(weakest, count - 1):
            r[k], a[k], source[k], slant[k] = r[k + 1], a[k + 1], source[k + 1], slant[k + 1]
        count -= 1
    return count


@leaf
def _glare(
    i: int, r: NDArray[np.float32], a: NDArray[np.float32], kind: NDArray[np.uint8],
    receiver: Receiver,
) -> tuple[float, float, int]:  # fmt: skip
    """Return range, amplitude and source of the strongest blooming onto a pulse from others of the same profile."""
    reach = min(int(receiver.blooming / receiver.step), 12)
    if reach == 0 or kind[i] == RETRO:
        return np.inf, -99.0, -1
    best, source = -99.0, -1
    for side in (-1, 1):
        for k in range(1, reach + 1):
            j = i + side * k * receiver.beams
            if j < 0 or j >= len(r):
                break
            if kind[j] != RETRO or a[j] < SATURATION_DB:
                continue
            glare = a[j] - GLARE_LOSS_DB - 14.0 * (k * receiver.step / receiver.blooming) ** 2
            if glare > best:
                best, source = glare, j
    return (np.inf, -99.0, -1) if source < 0 else (float(r[source]), best, source)


@leaf
def _gather(
    i: int, central: Echoes, extra: Echoes, slots: Slots,
    chance: float, r: NDArray[np.float64], a: NDArray[np.float64], source: NDArray[np.int64],
    slant: NDArray[np.float64],
) -> int:  # fmt: skip
    """Write the echoes of one pulse's rays, each with its share of the energy, and return their number."""
    n, count, aside = len(slots.edge), 0, 0.0
    edge, more, ghost = slots.edge[i], slots.more[i], slots.ghost[i]
    rays = slots.n_more if more >= 0 else 0
    if edge >= 0:
        aside = 0.2 + 0.35 * chance if rays == 0 else 0.65 / (1.0 + rays)
    if np.isfinite(central.distance[i]):
        share = 1.0 - aside * (1 + rays)
        r[0], a[0] = central.distance[i], central.amplitude[i] + 10 * np.log10(share)
        slant[0], source[0] = central.tangent[i], i
        count = 1
    for k in range(rays + 2):
        e, share = (ghost, 1.0) if k == rays + 1 else (edge if k == 0 else more + k - 1, aside)
        if e < 0 or (edge < 0 and k <= rays) or not np.isfinite(extra.distance[e]):
            continue
        r[count], a[count] = extra.distance[e], extra.amplitude[e] + 10 * np.log10(share)
        slant[count], source[count] = extra.tangent[e], n + e
        count += 1
    return count


@leaf
def _detect(
    i: int, count: int, chance: NDArray[np.float32], noise: NDArray[np.float32], receiver: Receiver,
    r: NDArray[np.float64], a: NDArray[np.float64], source: NDArray[np.int64], slant: NDArray[np.float64],
) -> int:  # fmt: skip
    """Keep the detected echoes, in place and with their noise, and return their number."""
    kept = 0
    for k in range(count):
        row = i if k == 0 else (i + 7919 * k) % len(chance)
        # Detection is probabilistic around the threshold, and fails rarely at any amplitude.
        needed = THRESHOLD_DB + 1.2 * noise[row, 1]
        if not receiver.min_range < r[k] < receiver.max_range or a[k] < needed:
            continue
        lot = chance[row] * 977.0
        if lot - np.floor(lot) < receiver.dropout:
            continue
        stretch = 0.25 * receiver.divergence * r[k] * slant[k] if receiver.range_noise > 0 else 0.0
        distance = r[k] + range_deviation(receiver.range_noise, a[k], stretch) * noise[row, 0]
        if receiver.range_step > 0:
            distance = np.round(distance / receiver.range_step) * receiver.range_step
        r[kept], a[kept], source[kept] = distance, a[k] + 0.4 * noise[row, 2], source[k]
        kept += 1
    return kept if kept <= receiver.max_returns else _strongest(kept, receiver.max_returns, r, a, source, slant)


@njit(cache=True, nogil=True, error_model="numpy")
def measure(
    central: Echoes, kind: NDArray[np.uint8],
    extra: Echoes, slots: Slots, power: Power, chance: NDArray[np.float32],
    noise: NDArray[np.float32], receiver: Receiver,
) -> tuple[NDArray, NDArray, NDArray, NDArray, NDArray, NDArray]:  # fmt: skip
    """Return pulse, range, intensity, source row (extra rays after the central ones), number and total of returns."""
    n, m = len(kind), 0
    room = n * receiver.max_returns
    pulse, distance = np.empty(room, np.int64), np.empty(room)
    intensity, origin = np.empty(room, np.float32), np.empty(room, np.int64)
    number, total = np.empty(room, np.uint8), np.empty(room, np.uint8)
    r, a, slant = np.empty(_MOST), np.empty(_MOST), np.empty(_MOST)
    source = np.empty(_MOST, np.int64)
    of_centre, amplitude, tangent = central.distance, central.amplitude, central.tangent
    lowered, gain = power
    controlled, uneven = len(lowered) > 0, len(gain) > 0
    for i in range(n):
        if slots.edge[i] < 0 and receiver.blooming == 0.0 and not np.isfinite(of_centre[i]):
            continue
        alone = slots.edge[i] < 0 and slots.ghost[i] < 0
        if alone and np.isfinite(of_centre[i]):
            r[0], a[0], slant[0], source[0], count = of_centre[i], amplitude[i], tangent[i], i, 1
        else:
            count = _gather(i, central, extra, slots, chance[i], r, a, source, slant)
        if receiver.blooming > 0.0:
            distance_of_glare, glare, row = _glare(i, of_centre, amplitude, kind, receiver)
            if row >= 0 and (count == 0 or abs(distance_of_glare - r[0]) > receiver.pulse_length):
                r[count], a[count], slant[count], source[count] = distance_of_glare, glare, 0.0, row
                count += 1
        if count > 1:
            count = _mix(count, receiver.pulse_length, r, a, source, slant)
        if controlled:
            for k in range(count):
                a[k] -= lowered[i]
        count = _detect(i, count, chance, noise, receiver, r, a, source, slant)
        for k in range(count):
            pulse[m], distance[m], origin[m] = i, r[k], source[k]
            intensity[m] = _recorded(a[k], r[k], gain[i] if uneven else 0.0, receiver)
            number[m], total[m] = k + 1, count
            m += 1
    return pulse[:m], distance[:m], intensity[:m], origin[:m], number[:m], total[:m]

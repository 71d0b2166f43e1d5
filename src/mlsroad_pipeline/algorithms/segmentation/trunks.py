"""Which stems carry a crown: trunks, as against poles that stand in one.

Where there is a crown around a stem, six things tell: poles are straight, upright and thin, the crown's middle lies
beside them, they reach up to its top, and a stem that looks less like a pole is near. Their weights are those of a
logistic regression on the stems of the training streets of the study of Yu et al. 2016 (docs/methods/segmentation.md,
`benchmarks/stem_weights.py`).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.segmentation.euclidean import cluster
from mlsroad_pipeline.algorithms.segmentation.stems import RADIUS, SLAB, Stem

_AROUND = 2.0  # of an axis, where a crown is looked for, metres
_CROWN = 300  # voxels that make a crown
_JOINED = 0.25  # voxels of one crown are this close, metres
_CENTRED = 0.1  # a crown whose middle is nearer to an axis stands around its own stem, metres
_BESIDE_TRUNK = 2.5  # the farthest pole from the trunk whose crown it stands in, metres
_INSIDE, _BASE = 0.3, 0.2  # of an axis, where spread is measured, and from where above the foot, metres
_RING, _CORE, _CLIMBS = 0.45, 0.2, 4  # of an axis and of its middle, where a section is looked for, metres, and rounds
_CLEAR = 0.4  # share of the sections that are not looked at: those with most leaves around them
_SECTIONS = 5  # that a stem is measured by, at least
_ROUNDS, _LEVELLED = 8, 0.01  # of the fit of a line by least deviations, and those that weigh alike, metres
_UPPER = 0.4  # share of a stem below which there is no crown
_TOP, _LOWEST = 0.98, 0.5  # share of a crown that lies below its top, and the least height of that, metres
_BEAM = 1.0  # height of a beam, and of its middle from the top of the post that carries it, metres
_SPAN = 5.0  # the least distance between two legs of a gantry, metres
_RESTS, _DENSE = 100, 80.0  # voxels of a beam within reach of its post, and per metre between two: wires have less
_OFFSET, _FIRST = -39.35, -2.44  # of likeness; a pole is what is one with odds of two to three: 0.41 is added
_WEIGHTS = -7.1, -3.19, -39.39, 2.97, 7.81, 0.55  # of likeness, in the order of `measure_stem`
_ASIDE = 3  # place of one of them there
_LEAST = 0.02  # added to bend, metres, and slope, as below it a smaller one tells little
_UNMEASURED = 0.05, 0.2  # bend and spread of a stem of few sections, metres


def judge_stems(
    xyz: NDArray[np.float64], counts: NDArray[np.int64], stems: list[Stem]
) -> tuple[list[Stem], list[list[Stem]]]:
    """Tell poles, and the legs of gantries, from trunks.

    Parameters
    ----------
    xyz : ndarray of float64, shape (v, 3)
        Voxels of a cluster, metres, z up.
    counts : ndarray of int64, shape (v,)
        Points in each.
    stems : list of Stem
        The stems in it.

    Returns
    -------
    poles : list of Stem
        The stems that no crown grows on.
    gantries : list of list of Stem
        Those that carry a beam between them, two or more each.
    """
    if not stems:
        return [], []
    beam, crowned, measures = measure_crowned(xyz, counts, stems)
    likeness = _OFFSET + measures @ _WEIGHTS
    first = find_first([stems[k] for k in crowned], likeness)
    is_pole = beam < 0
    is_pole[crowned] = (likeness + _FIRST * first > 0) & ~(first & (measures[:, _ASIDE] < _CENTRED))
    poles = [stem for stem, pole in zip(stems, is_pole, strict=True) if pole]
    groups = [
        [stem for stem, b in zip(stems, beam, strict=True) if b == number] for number in np.unique(beam[beam >= 0])
    ]
    return poles, [legs for legs in groups if len(legs) > 1 and _spans(_beside(stems, xyz), legs)]


def measure_crowned(
    xyz: NDArray[np.float64], counts: NDArray[np.int64], stems: list[Stem]
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
    """Find the stems of a cluster that stand in crowns, and measure them.

    Parameters
    ----------
    xyz : ndarray of float64, shape (v, 3)
        Voxels of the cluster, metres, z up.
    counts : ndarray of int64, shape (v,)
        Points in each.
    stems : list of Stem
        The stems in it, one or more.

    Returns
    -------
    beam : ndarray of int64, shape (n,)
        Number of the beam that each carries; -1 for none.
    crowned : ndarray of int64, shape (c,)
        Places in `stems` of those in crowns, which carry no beam.
    measures : ndarray of float64, shape (c, 6)
        What `measure_stem` gave for these.
    """
    rest = _beside(stems, xyz)
    size, aside, beam = _crowns(rest, stems)
    _find_second_legs(rest, stems, beam)
    crowned = np.flatnonzero((beam < 0) & (size >= _CROWN))
    measures = [measure_stem(stems[k], xyz, counts, aside[k]) for k in crowned]
    return beam, crowned, np.array(measures, np.float64).reshape(-1, len(_WEIGHTS))


def _beside(stems: list[Stem], xyz: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the voxels that are not on a stem."""
    rest = np.ones(len(xyz), np.bool_)
    for stem in stems:
        rest &= (stem.distance(xyz) > RADIUS) | (xyz[:, 2] > stem.high + SLAB)
    return xyz[rest]


def _find_second_legs(places: NDArray[np.float64], stems: list[Stem], beam: NDArray[np.int64]) -> None:
    """Give stems the number of the beam that they carry the other end of, in place: a crown beside it may hide it."""
    for k in np.flatnonzero(beam >= 0):
        one = stems[k]
        for j in np.flatnonzero(beam < 0):
            other = stems[j]
            apart = np.hypot(*(one.base + one.slope * one.high - other.base - other.slope * other.high))
            if apart >= _SPAN and abs(one.high - other.high) <= _BEAM and _spans(places, [one, other]):
                beam[j] = beam[k]


def _spans(places: NDArray[np.float64], legs: list[Stem]) -> bool:
    """Tell whether there is a beam between legs, and not some wires."""
    top = np.array([leg.base + leg.slope * leg.high for leg in legs])
    far = top[np.argmax(np.hypot(*(top - top[0]).T))] - top[0]
    span = float(np.hypot(*far))
    along = (places[:, :2] - top[0]) @ far / max(span, _BEAM)
    across = (places[:, :2] - top[0]) @ np.array([-far[1], far[0]]) / max(span, _BEAM)
    between = (along >= 0) & (along <= span) & (np.abs(across) <= _BEAM)
    high = np.abs(places[:, 2] - np.mean([leg.high for leg in legs])) <= 2 * _BEAM
    return bool((between & high).sum() >= _DENSE * span)


def _crowns(
    places: NDArray[np.float64], stems: list[Stem]
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.int64]]:
    """Return the size of the crown around each stem, and how far aside its middle lies.

    And, where it is no crown but the beam of a gantry or a mast's arm, low and at the top of the stem, its number; -1
    elsewhere.
    """
    piece = cluster(np.ascontiguousarray(places), tolerance=_JOINED)
    size, aside, beam = np.zeros(len(stems), np.int64), np.zeros(len(stems)), np.full(len(stems), -1)
    for k, stem in enumerate(stems):
        here = (stem.distance(places) <= _AROUND) & _beside_crown(stem, places)
        size[k] = here.sum()
        if not here.any():
            continue
        aside[k] = np.hypot(*stem.away(places[here]).mean(axis=0))
        number = int(np.bincount(piece[here]).argmax())
        low, middle, high = np.quantile(places[here, 2], (0.15, 0.5, 0.95))
        flat = high - low < _BEAM and abs(middle - stem.high) < _BEAM
        if flat and (piece == number).sum() >= _CROWN and size[k] >= _RESTS:
            beam[k] = number
    return size, aside, beam


def _beside_crown(stem: Stem, xyz: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Tell which places are as high as the crown of a stem may be."""
    return xyz[:, 2] >= stem.low + _UPPER * (stem.high - stem.low)


def measure_stem(stem: Stem, xyz: NDArray[np.float64], counts: NDArray[np.int64], aside: float) -> NDArray[np.float64]:
    """Measure what tells a pole in a crown from a trunk.

    Parameters
    ----------
    stem : Stem
        The stem.
    xyz : ndarray of float64, shape (v, 3)
        Voxels of its cluster, metres, z up.
    counts : ndarray of int64, shape (v,)
        Points in each.
    aside : float
        How far the crown's middle lies from its axis, metres.

    Returns
    -------
    ndarray of float64, shape (6,)
        Logarithms of how far its sections lie off a straight line, metres, and of its slope; the spread of the thin
        sections, metres; `aside`; its length over the height of the crown's top; and what of that is above it, metres.
    """
    near = stem.distance(xyz) <= _AROUND
    xyz, counts = xyz[near], counts[near]  # a wood may be one cluster of a million voxels
    upper = (stem.distance(xyz) > _INSIDE) & _beside_crown(stem, xyz)
    length = stem.high - stem.low
    top = float(np.quantile(xyz[upper, 2], _TOP)) - stem.low if upper.any() else length
    bend, lean = _bend(stem, xyz, counts)
    logarithms = np.log(_LEAST + bend), np.log(_LEAST + lean)
    spread = _spread(stem, xyz, counts)
    return np.array([*logarithms, spread, min(aside, _AROUND), length / max(top, _LOWEST), top - length])


def find_first(stems: list[Stem], likeness: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Tell which stems look less like poles than those around them: something has to carry a crown.

    Parameters
    ----------
    stems : list of Stem
        Stems in crowns.
    likeness : ndarray of float64, shape (n,)
        How much each looks like a pole.

    Returns
    -------
    ndarray of bool, shape (n,)
        One flag per stem.
    """
    foot = np.array([stem.base + stem.slope * stem.low for stem in stems]).reshape(-1, 2)
    near = np.hypot(*(foot[:, None] - foot[None]).transpose(2, 0, 1)) <= _BESIDE_TRUNK
    return np.array([likeness[k] <= likeness[near[k]].min() for k in range(len(stems))], np.bool_)


def _sections(stem: Stem, xyz: NDArray[np.float64], reach: float) -> tuple[NDArray[np.int64], NDArray[np.int64]] | None:
    """Return the voxels around an axis, and the section of each, 0, 1, ...; None where there are few sections."""
    height = xyz[:, 2] - stem.low
    rows = np.flatnonzero((height >= _BASE) & (xyz[:, 2] <= stem.high) & (stem.distance(xyz) <= reach))
    _, section = np.unique(np.floor(height[rows] / SLAB), return_inverse=True)
    return (rows, section) if section.max(initial=-1) + 1 >= _SECTIONS else None


def _bend(stem: Stem, xyz: NDArray[np.float64], counts: NDArray[np.int64]) -> tuple[float, float]:
    """Return how far the sections of a stem lie off a straight line, and the slope of that.

    Points are counted, not voxels, and sections with many leaves around them are left out.
    """
    found = _sections(stem, xyz, _RING)
    if found is None:
        return _UNMEASURED[0], float(np.hypot(*stem.slope))
    rows, section = found
    mass = counts[rows].astype(np.float64)
    middle, share = _climb(stem.away(xyz[rows]), mass, section)
    clear = share >= np.quantile(share, _CLEAR)
    level = np.bincount(section, mass * xyz[rows, 2]) / np.bincount(section, mass)
    line, off = _straight_line(np.column_stack([middle + stem.base + level[:, None] * stem.slope, level])[clear])
    return float(np.median(off)), float(np.hypot(*line[1]))


def _climb(
    away: NDArray[np.float64], mass: NDArray[np.float64], section: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return where in each section points crowd, from the axis on, and the share of them that lies there."""
    n = int(section.max()) + 1
    middle = np.zeros((n, 2))
    for _ in range(_CLIMBS):
        core = np.hypot(*(away - middle[section]).T) <= _CORE
        inner = np.bincount(section[core], mass[core], minlength=n)
        mean = [np.bincount(section[core], mass[core] * away[core, axis], minlength=n) for axis in range(2)]
        middle = np.where(inner[:, None] > 0, np.column_stack(mean) / np.maximum(inner, 1.0)[:, None], middle)
    core = np.hypot(*(away - middle[section]).T) <= _CORE
    return middle, np.bincount(section[core], mass[core], minlength=n) / np.bincount(section, mass)


def _spread(stem: Stem, xyz: NDArray[np.float64], counts: NDArray[np.int64]) -> float:
    """Return how far points spread in the thin sections of a stem."""
    found = _sections(stem, xyz, _INSIDE)
    if found is None:
        return _UNMEASURED[1]
    rows, section = found
    mass = np.bincount(section, counts[rows])
    middle = np.column_stack([np.bincount(section, counts[rows] * xyz[rows, axis]) / mass for axis in range(2)])
    off = ((xyz[rows, :2] - middle[section]) ** 2).sum(axis=1)
    return float(np.quantile(np.sqrt(np.bincount(section, counts[rows] * off) / mass), 0.25))


def _straight_line(middle: NDArray[np.floating]) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
    """Return the upright line of least deviations through places, place and slope, and their distances from it."""
    design = np.column_stack([np.ones(len(middle)), middle[:, 2] - middle[:, 2].mean()])
    weight = np.ones((len(middle), 1))
    for _ in range(_ROUNDS):
        line, *_ = np.linalg.lstsq(design * weight, middle[:, :2] * weight, rcond=None)
        off = np.hypot(*(middle[:, :2] - design @ line).T)
        weight = 1.0 / np.sqrt(np.maximum(off, _LEVELLED))[:, None]
    return line, off

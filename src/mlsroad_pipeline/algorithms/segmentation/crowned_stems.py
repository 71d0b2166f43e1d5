"""Classification of stems in crowns as poles or trunks, and detection of gantry legs. Lengths in metres, z up.

Poles in crowns are straight, upright and thin. They stand beside the crown's centre and reach its top, and a less
pole-like stem is near. The weights of these measures are those of a logistic regression on the simulated training
streets of the study of Yu et al. 2016 (docs/methods/segmentation.md). None of this is in the paper.
"""

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.segmentation.euclidean import cluster
from mlsroad_pipeline.algorithms.segmentation.stems import DENSE, STEM_RADIUS, Stem

# A stem with a positive sum is a pole. Fitted weights, in the order of `measure_stem`; the intercept contains the
# logarithm of 3/2, so that a stem is a pole from odds of two to three.
_INTERCEPT, _WEIGHTS = -39.35, (-7.1, -3.19, -39.39, 2.97, 7.81, 0.55)
_TRUNK_WEIGHT = -2.44  # added for the least pole-like of neighbouring stems, fitted: every crown has a trunk
_TRUNK_DISTANCE = 2.5  # m, stems within this distance are neighbours
_OFFSET_COLUMN = 3  # of the offset of the crown's centre among the measures
_CENTRE_OFFSET = 0.1  # m, the least pole-like stem is a trunk where it is this close to the crown's centre

# Limits of crowns, set by hand.
_CROWN_RADIUS = 2.0  # m around the axis
_CROWN_MIN_VOXELS = 300  # within that radius; stems with fewer voxels around them are poles
_CROWN_TOLERANCE = 0.25  # m, voxels closer than this are one piece: a crown or a beam
_CROWN_BASE = 0.4  # share of a stem's height below which no crown is measured
_CROWN_TOP, _MIN_TOP = 0.98, 0.5  # quantile of heights that is the top, and the least height of that above the foot, m

# Limits of the beam of a gantry, set by hand.
_BEAM_HEIGHT = 1.0  # m, largest height of a beam and of its distance from the post's top
_BEAM_QUANTILES = (0.15, 0.5, 0.95)  # of heights, that are bottom, middle and top of a beam
_BEAM_MIN_SPAN = 5.0  # m between two legs
_BEAM_MIN_VOXELS = 100  # around a leg
_BEAM_DENSITY = 80.0  # voxels per metre of span; wires have fewer

# Measuring a stem. A change of these requires new weights.
_MEASURE_BASE = 0.2  # m above the foot, from which sections are measured
_MIN_SECTIONS = 5  # with fewer sections the next two values stand for the measures
_DEFAULT_BEND, _DEFAULT_SPREAD = 0.05, 0.2  # m
_LOG_OFFSET = 0.02  # added to bend (m) and slope before the logarithm
_SPREAD_RADIUS, _SPREAD_QUANTILE = 0.3, 0.25  # m; quantile of the sections' spreads, which leaves out those with leaves
_AXIS_RADIUS, _AXIS_CORE = 0.45, 0.2  # m, search around the axis, and radius of the mean shift
_AXIS_ITERATIONS = 4  # of the mean shift
_FOLIAGE_QUANTILE = 0.4  # share of the sections left out, those with most points off their core
_LINE_ITERATIONS, _LINE_MIN_RESIDUAL = 8, 0.01  # of the line of least absolute deviations; weights are equal below, m


def find_poles(
    xyz: NDArray[np.float64], counts: NDArray[np.int64], stems: list[Stem]
) -> tuple[list[Stem], list[list[Stem]]]:
    """Return the stems of a cluster of voxels that carry neither crown nor beam, and groups of legs under one beam."""
    if not stems:
        return [], []
    beam, crowned, measures = measure_crowned(xyz, counts, stems)
    scores = _INTERCEPT + measures @ _WEIGHTS
    least = find_least_pole_like([stems[k] for k in crowned], scores)
    central = measures[:, _OFFSET_COLUMN] < _CENTRE_OFFSET
    is_pole = beam < 0
    is_pole[crowned] = (scores + _TRUNK_WEIGHT * least > 0) & ~(least & central)
    poles = [stem for stem, pole in zip(stems, is_pole, strict=True) if pole]
    groups = [
        [stem for stem, b in zip(stems, beam, strict=True) if b == number] for number in np.unique(beam[beam >= 0])
    ]
    return poles, [legs for legs in groups if len(legs) > 1 and _spans(_beside(stems, xyz), legs)]


def measure_crowned(
    xyz: NDArray[np.float64], counts: NDArray[np.int64], stems: list[Stem]
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
    """Return the beam of each stem (-1 for none), and index and measures of those in crowns, which carry no beam."""
    rest = _beside(stems, xyz)
    size, aside, beam = _crowns(rest, stems)
    _find_second_legs(rest, stems, beam)
    crowned = np.flatnonzero((beam < 0) & (size >= _CROWN_MIN_VOXELS))
    measures = [measure_stem(stems[k], xyz, counts, aside[k]) for k in crowned]
    return beam, crowned, np.array(measures, np.float64).reshape(-1, len(_WEIGHTS))


def _beside(stems: list[Stem], xyz: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the voxels that are not on a stem."""
    rest = np.ones(len(xyz), np.bool_)
    for stem in stems:
        rest &= (stem.distance(xyz) > STEM_RADIUS) | (xyz[:, 2] > stem.high + DENSE.section_height)
    return xyz[rest]


def _find_second_legs(places: NDArray[np.float64], stems: list[Stem], beam: NDArray[np.int64]) -> None:
    """Assign, in place, the number of a beam to the stem at its other end, which a crown may have hidden."""
    for k in np.flatnonzero(beam >= 0):
        one = stems[k]
        for j in np.flatnonzero(beam < 0):
            other = stems[j]
            apart = np.hypot(*(one.at(one.high) - other.at(other.high)))
            level = abs(one.high - other.high) <= _BEAM_HEIGHT
            if apart >= _BEAM_MIN_SPAN and level and _spans(places, [one, other]):
                beam[j] = beam[k]


def _spans(places: NDArray[np.float64], legs: list[Stem]) -> bool:
    """Return whether a beam lies between legs."""
    top = np.array([leg.at(leg.high) for leg in legs])
    far = top[np.argmax(np.hypot(*(top - top[0]).T))] - top[0]
    span = float(np.hypot(*far))
    along = (places[:, :2] - top[0]) @ far / max(span, _BEAM_HEIGHT)
    across = (places[:, :2] - top[0]) @ np.array([-far[1], far[0]]) / max(span, _BEAM_HEIGHT)
    between = (along >= 0) & (along <= span) & (np.abs(across) <= _BEAM_HEIGHT)
    high = np.abs(places[:, 2] - np.mean([leg.high for leg in legs])) <= 2 * _BEAM_HEIGHT
    return bool((between & high).sum() >= _BEAM_DENSITY * span)


def _crowns(
    places: NDArray[np.float64], stems: list[Stem]
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.int64]]:
    """Return the size of the crown around each stem, the offset of its centre, and the number of a beam.

    A piece that is flat and at the top of the stem is not a crown, but a gantry's beam or a mast's arm; -1 for none.
    """
    piece = cluster(np.ascontiguousarray(places), tolerance=_CROWN_TOLERANCE)
    size, aside, beam = np.zeros(len(stems), np.int64), np.zeros(len(stems)), np.full(len(stems), -1)
    for k, stem in enumerate(stems):
        here = (stem.distance(places) <= _CROWN_RADIUS) & _at_crown_height(stem, places)
        size[k] = here.sum()
        if not here.any():
            continue
        aside[k] = np.hypot(*stem.away(places[here]).mean(axis=0))
        number = int(np.bincount(piece[here]).argmax())
        low, middle, high = np.quantile(places[here, 2], _BEAM_QUANTILES)
        flat = high - low < _BEAM_HEIGHT and abs(middle - stem.high) < _BEAM_HEIGHT
        if flat and (piece == number).sum() >= _CROWN_MIN_VOXELS and size[k] >= _BEAM_MIN_VOXELS:
            beam[k] = number
    return size, aside, beam


def _at_crown_height(stem: Stem, xyz: NDArray[np.float64]) -> NDArray[np.bool_]:
    return xyz[:, 2] >= stem.low + _CROWN_BASE * (stem.high - stem.low)


def measure_stem(stem: Stem, xyz: NDArray[np.float64], counts: NDArray[np.int64], aside: float) -> NDArray[np.float64]:
    """Return the six measures of a stem in a crown whose centre is `aside` from its axis.

    Logarithms of the sections' deviation from a line, m, and of its slope; spread of the thin sections, m; `aside`, m;
    length over the height of the crown's top; height of that top above the upper end, m.
    """
    near = stem.distance(xyz) <= _CROWN_RADIUS
    xyz, counts = xyz[near], counts[near]  # a wood may be one cluster of a million voxels
    upper = (stem.distance(xyz) > _SPREAD_RADIUS) & _at_crown_height(stem, xyz)
    length = stem.high - stem.low
    top = float(np.quantile(xyz[upper, 2], _CROWN_TOP)) - stem.low if upper.any() else length
    bend, lean = _bend(stem, xyz, counts)
    logarithms = np.log(_LOG_OFFSET + bend), np.log(_LOG_OFFSET + lean)
    spread = _spread(stem, xyz, counts)
    return np.array([*logarithms, spread, min(aside, _CROWN_RADIUS), length / max(top, _MIN_TOP), top - length])


def find_least_pole_like(stems: list[Stem], scores: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return which stems in crowns have the lowest score of all near them; a higher score is more pole-like."""
    foot = np.array([stem.at(stem.low) for stem in stems]).reshape(-1, 2)
    near = np.hypot(*(foot[:, None] - foot[None]).transpose(2, 0, 1)) <= _TRUNK_DISTANCE
    return np.array([scores[k] <= scores[near[k]].min() for k in range(len(stems))], np.bool_)


def _sections(stem: Stem, xyz: NDArray[np.float64], reach: float) -> tuple[NDArray[np.int64], NDArray[np.int64]] | None:
    """Return the voxels around an axis, and the section of each, 0, 1, ...; None where there are few sections."""
    height = xyz[:, 2] - stem.low
    rows = np.flatnonzero((height >= _MEASURE_BASE) & (xyz[:, 2] <= stem.high) & (stem.distance(xyz) <= reach))
    _, section = np.unique(np.floor(height[rows] / DENSE.section_height), return_inverse=True)
    return (rows, section) if section.max(initial=-1) + 1 >= _MIN_SECTIONS else None


def _bend(stem: Stem, xyz: NDArray[np.float64], counts: NDArray[np.int64]) -> tuple[float, float]:
    """Return the deviation of a stem's sections from a straight line, and the slope of that line.

    Points are counted, not voxels, and sections with many leaves around them are excluded.
    """
    sections = _sections(stem, xyz, _AXIS_RADIUS)
    if sections is None:
        return _DEFAULT_BEND, float(np.hypot(*stem.slope))
    rows, section = sections
    mass = counts[rows].astype(np.float64)
    middle, share = _shift_to_core(stem.away(xyz[rows]), mass, section)
    clear = share >= np.quantile(share, _FOLIAGE_QUANTILE)
    level = np.bincount(section, mass * xyz[rows, 2]) / np.bincount(section, mass)
    line, off = _straight_line(np.column_stack([middle + stem.base + level[:, None] * stem.slope, level])[clear])
    return float(np.median(off)), float(np.hypot(*line[1]))


def _shift_to_core(
    away: NDArray[np.float64], mass: NDArray[np.float64], section: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the densest place of each section by mean shift from the axis, and the share of points in its core."""
    n = int(section.max()) + 1
    middle = np.zeros((n, 2))
    for _ in range(_AXIS_ITERATIONS):
        core = np.hypot(*(away - middle[section]).T) <= _AXIS_CORE
        inner = np.bincount(section[core], mass[core], minlength=n)
        mean = [np.bincount(section[core], mass[core] * away[core, axis], minlength=n) for axis in range(2)]
        middle = np.where(inner[:, None] > 0, np.column_stack(mean) / np.maximum(inner, 1.0)[:, None], middle)
    core = np.hypot(*(away - middle[section]).T) <= _AXIS_CORE
    return middle, np.bincount(section[core], mass[core], minlength=n) / np.bincount(section, mass)


def _spread(stem: Stem, xyz: NDArray[np.float64], counts: NDArray[np.int64]) -> float:
    """Return the horizontal spread of points in the thin sections of a stem."""
    sections = _sections(stem, xyz, _SPREAD_RADIUS)
    if sections is None:
        return _DEFAULT_SPREAD
    rows, section = sections
    mass = np.bincount(section, counts[rows])
    middle = np.column_stack([np.bincount(section, counts[rows] * xyz[rows, axis]) / mass for axis in range(2)])
    off = ((xyz[rows, :2] - middle[section]) ** 2).sum(axis=1)
    return float(np.quantile(np.sqrt(np.bincount(section, counts[rows] * off) / mass), _SPREAD_QUANTILE))


def _straight_line(middle: NDArray[np.floating]) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
    """Return the line of least absolute deviations through places, position and slope, and their distances from it."""
    design = np.column_stack([np.ones(len(middle)), middle[:, 2] - middle[:, 2].mean()])
    weight = np.ones((len(middle), 1))
    for _ in range(_LINE_ITERATIONS):
        line, *_ = np.linalg.lstsq(design * weight, middle[:, :2] * weight, rcond=None)
        off = np.hypot(*(middle[:, :2] - design @ line).T)
        weight = 1.0 / np.sqrt(np.maximum(off, _LINE_MIN_RESIDUAL))[:, None]
    return line, off

"""Classification of stems in crowns as poles or trunks, and detection of gantry legs.

Poles in crowns are straight, upright and thin. They stand beside the crown's centre and reach its top, and a less
pole-like stem is near. The weights of these measures are those of a logistic regression on the stems of the training
streets of the study of Yu et al. 2016 (docs/methods/segmentation.md, `benchmarks/stem_weights.py`).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.segmentation.euclidean import cluster
from mlsroad_pipeline.algorithms.segmentation.pole_parameters import POLE_REFINEMENT, PoleRefinementParameters
from mlsroad_pipeline.algorithms.segmentation.stems import Stem

_OFFSET_COLUMN = 3  # of the offset of the crown's centre among the measures of `measure_stem`


def classify_stems(
    xyz: NDArray[np.float64],
    counts: NDArray[np.int64],
    stems: list[Stem],
    refinement: PoleRefinementParameters = POLE_REFINEMENT,
) -> tuple[list[Stem], list[list[Stem]]]:
    """Separate poles and the legs of gantries from trunks.

    Parameters
    ----------
    xyz : ndarray of float64, shape (v, 3)
        Voxels of a cluster, metres, z up.
    counts : ndarray of int64, shape (v,)
        Points in each.
    stems : list of Stem
        The stems in it.
    refinement : PoleRefinementParameters
        Limits and weights.

    Returns
    -------
    poles : list of Stem
        The stems that carry neither a crown nor a beam.
    gantries : list of list of Stem
        The stems that carry a beam between them, two or more each.
    """
    if not stems:
        return [], []
    p = refinement
    beam, crowned, measures = measure_crowned(xyz, counts, stems, p)
    scores = p.pole_intercept + measures @ p.pole_weights
    least = find_least_pole_like([stems[k] for k in crowned], scores, p)
    central = measures[:, _OFFSET_COLUMN] < p.crown_centre_offset
    is_pole = beam < 0
    is_pole[crowned] = (scores + p.trunk_weight * least > 0) & ~(least & central)
    poles = [stem for stem, pole in zip(stems, is_pole, strict=True) if pole]
    groups = [
        [stem for stem, b in zip(stems, beam, strict=True) if b == number] for number in np.unique(beam[beam >= 0])
    ]
    return poles, [legs for legs in groups if len(legs) > 1 and _spans(_beside(stems, xyz, p), legs, p)]


def measure_crowned(
    xyz: NDArray[np.float64],
    counts: NDArray[np.int64],
    stems: list[Stem],
    refinement: PoleRefinementParameters = POLE_REFINEMENT,
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
    refinement : PoleRefinementParameters
        Limits of crowns and beams.

    Returns
    -------
    beam : ndarray of int64, shape (n,)
        Number of the beam that each carries; -1 for none.
    crowned : ndarray of int64, shape (c,)
        Indices in `stems` of those in crowns, which carry no beam.
    measures : ndarray of float64, shape (c, 6)
        Their measures, see `measure_stem`.
    """
    p = refinement
    rest = _beside(stems, xyz, p)
    size, aside, beam = _crowns(rest, stems, p)
    _find_second_legs(rest, stems, beam, p)
    crowned = np.flatnonzero((beam < 0) & (size >= p.crown_min_voxels))
    measures = [measure_stem(stems[k], xyz, counts, aside[k], p) for k in crowned]
    return beam, crowned, np.array(measures, np.float64).reshape(-1, len(p.pole_weights))


def _beside(stems: list[Stem], xyz: NDArray[np.float64], p: PoleRefinementParameters) -> NDArray[np.float64]:
    """Return the voxels that are not on a stem."""
    rest = np.ones(len(xyz), np.bool_)
    for stem in stems:
        rest &= (stem.distance(xyz) > p.stem_radius) | (xyz[:, 2] > stem.high + p.section_height)
    return xyz[rest]


def _find_second_legs(
    places: NDArray[np.float64], stems: list[Stem], beam: NDArray[np.int64], p: PoleRefinementParameters
) -> None:
    """Assign, in place, the number of a beam to the stem at its other end, which a crown may have hidden."""
    for k in np.flatnonzero(beam >= 0):
        one = stems[k]
        for j in np.flatnonzero(beam < 0):
            other = stems[j]
            apart = np.hypot(*(one.base + one.slope * one.high - other.base - other.slope * other.high))
            level = abs(one.high - other.high) <= p.beam_height
            if apart >= p.beam_min_span and level and _spans(places, [one, other], p):
                beam[j] = beam[k]


def _spans(places: NDArray[np.float64], legs: list[Stem], p: PoleRefinementParameters) -> bool:
    """Return whether a beam lies between legs; wires have fewer voxels."""
    top = np.array([leg.at(leg.high) for leg in legs])
    far = top[np.argmax(np.hypot(*(top - top[0]).T))] - top[0]
    span = float(np.hypot(*far))
    along = (places[:, :2] - top[0]) @ far / max(span, p.beam_height)
    across = (places[:, :2] - top[0]) @ np.array([-far[1], far[0]]) / max(span, p.beam_height)
    between = (along >= 0) & (along <= span) & (np.abs(across) <= p.beam_height)
    high = np.abs(places[:, 2] - np.mean([leg.high for leg in legs])) <= 2 * p.beam_height
    return bool((between & high).sum() >= p.beam_density * span)


def _crowns(
    places: NDArray[np.float64], stems: list[Stem], p: PoleRefinementParameters
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.int64]]:
    """Return the size of the crown around each stem, the offset of its centre, and the number of a beam.

    A piece that is flat and at the top of the stem is no crown but the beam of a gantry or a mast's arm; the number is
    -1 elsewhere.
    """
    piece = cluster(np.ascontiguousarray(places), tolerance=p.crown_tolerance)
    size, aside, beam = np.zeros(len(stems), np.int64), np.zeros(len(stems)), np.full(len(stems), -1)
    for k, stem in enumerate(stems):
        here = (stem.distance(places) <= p.crown_radius) & _at_crown_height(stem, places, p)
        size[k] = here.sum()
        if not here.any():
            continue
        aside[k] = np.hypot(*stem.away(places[here]).mean(axis=0))
        number = int(np.bincount(piece[here]).argmax())
        low, middle, high = np.quantile(places[here, 2], p.beam_quantiles)
        flat = high - low < p.beam_height and abs(middle - stem.high) < p.beam_height
        if flat and (piece == number).sum() >= p.crown_min_voxels and size[k] >= p.beam_min_voxels:
            beam[k] = number
    return size, aside, beam


def _at_crown_height(stem: Stem, xyz: NDArray[np.float64], p: PoleRefinementParameters) -> NDArray[np.bool_]:
    """Return which places are high enough to belong to the crown of a stem."""
    return xyz[:, 2] >= stem.low + p.crown_base * (stem.high - stem.low)


def measure_stem(
    stem: Stem,
    xyz: NDArray[np.float64],
    counts: NDArray[np.int64],
    aside: float,
    refinement: PoleRefinementParameters = POLE_REFINEMENT,
) -> NDArray[np.float64]:
    """Measure how pole-like a stem in a crown is.

    Parameters
    ----------
    stem : Stem
        The stem.
    xyz : ndarray of float64, shape (v, 3)
        Voxels of its cluster, metres, z up.
    counts : ndarray of int64, shape (v,)
        Points in each.
    aside : float
        Distance of the crown's centre from the stem's axis, metres.
    refinement : PoleRefinementParameters
        Radii, quantiles and defaults of the measures.

    Returns
    -------
    ndarray of float64, shape (6,)
        Logarithms of the deviation of its sections from a straight line, metres, and of its slope; the spread of the
        thin sections, metres; `aside`; its length over the height of the crown's top; and the height of that top above
        its end, metres.
    """
    p = refinement
    near = stem.distance(xyz) <= p.crown_radius
    xyz, counts = xyz[near], counts[near]  # a wood may be one cluster of a million voxels
    upper = (stem.distance(xyz) > p.spread_radius) & _at_crown_height(stem, xyz, p)
    length = stem.high - stem.low
    top = float(np.quantile(xyz[upper, 2], p.crown_top_quantile)) - stem.low if upper.any() else length
    bend, lean = _bend(stem, xyz, counts, p)
    logarithms = np.log(p.log_offset + bend), np.log(p.log_offset + lean)
    spread = _spread(stem, xyz, counts, p)
    reached = length / max(top, p.crown_min_top)
    return np.array([*logarithms, spread, min(aside, p.crown_radius), reached, top - length])


def find_least_pole_like(
    stems: list[Stem], scores: NDArray[np.float64], refinement: PoleRefinementParameters = POLE_REFINEMENT
) -> NDArray[np.bool_]:
    """Find the stems that are less pole-like than all near them: every crown has a trunk.

    Parameters
    ----------
    stems : list of Stem
        Stems in crowns.
    scores : ndarray of float64, shape (n,)
        Weighted sum of the measures of each; larger is more pole-like.
    refinement : PoleRefinementParameters
        `trunk_distance` is the distance within which stems are compared.

    Returns
    -------
    ndarray of bool, shape (n,)
        One flag per stem.
    """
    foot = np.array([stem.at(stem.low) for stem in stems]).reshape(-1, 2)
    near = np.hypot(*(foot[:, None] - foot[None]).transpose(2, 0, 1)) <= refinement.trunk_distance
    return np.array([scores[k] <= scores[near[k]].min() for k in range(len(stems))], np.bool_)


def _sections(
    stem: Stem, xyz: NDArray[np.float64], reach: float, p: PoleRefinementParameters
) -> tuple[NDArray[np.int64], NDArray[np.int64]] | None:
    """Return the voxels around an axis, and the section of each, 0, 1, ...; None where there are few sections."""
    height = xyz[:, 2] - stem.low
    rows = np.flatnonzero((height >= p.measure_base) & (xyz[:, 2] <= stem.high) & (stem.distance(xyz) <= reach))
    _, section = np.unique(np.floor(height[rows] / p.section_height), return_inverse=True)
    return (rows, section) if section.max(initial=-1) + 1 >= p.min_sections else None


def _bend(
    stem: Stem, xyz: NDArray[np.float64], counts: NDArray[np.int64], p: PoleRefinementParameters
) -> tuple[float, float]:
    """Return the deviation of a stem's sections from a straight line, and the slope of that line.

    Points are counted, not voxels, and sections with many leaves around them are excluded.
    """
    sections = _sections(stem, xyz, p.axis_radius, p)
    if sections is None:
        return p.default_bend, float(np.hypot(*stem.slope))
    rows, section = sections
    mass = counts[rows].astype(np.float64)
    middle, share = _shift_to_core(stem.away(xyz[rows]), mass, section, p)
    clear = share >= np.quantile(share, p.foliage_quantile)
    level = np.bincount(section, mass * xyz[rows, 2]) / np.bincount(section, mass)
    line, off = _straight_line(np.column_stack([middle + stem.base + level[:, None] * stem.slope, level])[clear], p)
    return float(np.median(off)), float(np.hypot(*line[1]))


def _shift_to_core(
    away: NDArray[np.float64], mass: NDArray[np.float64], section: NDArray[np.int64], p: PoleRefinementParameters
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the densest place of each section by mean shift from the axis, and the share of points in its core."""
    n = int(section.max()) + 1
    middle = np.zeros((n, 2))
    for _ in range(p.axis_iterations):
        core = np.hypot(*(away - middle[section]).T) <= p.axis_core_radius
        inner = np.bincount(section[core], mass[core], minlength=n)
        mean = [np.bincount(section[core], mass[core] * away[core, axis], minlength=n) for axis in range(2)]
        middle = np.where(inner[:, None] > 0, np.column_stack(mean) / np.maximum(inner, 1.0)[:, None], middle)
    core = np.hypot(*(away - middle[section]).T) <= p.axis_core_radius
    return middle, np.bincount(section[core], mass[core], minlength=n) / np.bincount(section, mass)


def _spread(stem: Stem, xyz: NDArray[np.float64], counts: NDArray[np.int64], p: PoleRefinementParameters) -> float:
    """Return the horizontal spread of points in the thin sections of a stem."""
    sections = _sections(stem, xyz, p.spread_radius, p)
    if sections is None:
        return p.default_spread
    rows, section = sections
    mass = np.bincount(section, counts[rows])
    middle = np.column_stack([np.bincount(section, counts[rows] * xyz[rows, axis]) / mass for axis in range(2)])
    off = ((xyz[rows, :2] - middle[section]) ** 2).sum(axis=1)
    return float(np.quantile(np.sqrt(np.bincount(section, counts[rows] * off) / mass), p.spread_quantile))


def _straight_line(
    middle: NDArray[np.floating], p: PoleRefinementParameters
) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
    """Return the line of least absolute deviations through places, position and slope, and their distances from it."""
    design = np.column_stack([np.ones(len(middle)), middle[:, 2] - middle[:, 2].mean()])
    weight = np.ones((len(middle), 1))
    for _ in range(p.line_iterations):
        line, *_ = np.linalg.lstsq(design * weight, middle[:, :2] * weight, rcond=None)
        off = np.hypot(*(middle[:, :2] - design @ line).T)
        weight = 1.0 / np.sqrt(np.maximum(off, p.line_min_residual))[:, None]
    return line, off

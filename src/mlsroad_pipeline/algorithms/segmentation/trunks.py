"""Which stems carry a crown: trunks, as against poles that stand in one.

Where there is a crown around a stem, five things tell: poles are straight, upright and thin, the crown's middle lies
beside them, and a stem that looks less like a pole is near. Their weights are those of a logistic regression on the
stems of the training streets of the study of Yu et al. 2016 (docs/methods/segmentation.md).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.segmentation.euclidean import cluster
from mlsroad_pipeline.algorithms.segmentation.stems import RADIUS, SLAB, Stem

_AROUND = 2.0  # of an axis, where a crown is looked for, metres
_CROWN = 300  # voxels that make a crown
_JOINED = 0.25  # voxels of one crown are this close, metres
_FOOT, _BESIDE, _STEM = 0.7, 0.3, 1.2  # of a stem that was not found: height of its foot, distance, width, metres
_CENTRED = 0.1  # a crown whose middle is nearer to an axis stands around its own stem, metres
_BESIDE_TRUNK = 2.5  # the farthest pole from the trunk whose crown it stands in, metres
_INSIDE, _BASE = 0.3, 0.2  # of an axis, what is measured of a section, and from where above the foot, metres
_SECTIONS = 5  # that a stem is measured by, at least
_ROUNDS, _LEVELLED = 5, 0.01  # of the fit of a line by least deviations, and those that weigh alike, metres
_BEAM = 1.0  # height of a beam, and of its middle from the top of the post that carries it, metres
_SPAN = 5.0  # the least distance between two legs of a gantry, metres
_RESTS, _DENSE = (
    100,
    80.0,
)  # voxels of a beam within reach of its post, and per metre between two posts: wires have less
_OFFSET, _FIRST = -29.8, -2.9  # of likeness
_BEND, _LEAN, _SPREAD, _MIDDLE = -5.7, -3.3, -5.2, 4.1  # of likeness; the first two per logarithm, then per metre
_LEAST = 0.02  # bend, metres, and slope below which a smaller one tells little
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
    rest = np.ones(len(xyz), np.bool_)
    for stem in stems:
        rest &= (stem.distance(xyz) > RADIUS) | (xyz[:, 2] > stem.high + SLAB)
    size, aside, hidden, beam = _crowns(xyz[rest], stems)
    _find_second_legs(xyz[rest], stems, beam)
    slender = np.array(
        [_slender(stem, xyz, counts) + _MIDDLE * min(off, _AROUND) for stem, off in zip(stems, aside, strict=True)]
    )
    foot = np.array([stem.base + stem.slope * stem.low for stem in stems])
    poles = []
    for k, stem in enumerate(stems):
        if beam[k] >= 0:
            continue
        if size[k] < _CROWN:
            poles.append(stem)
            continue
        apart = np.hypot(*(foot - foot[k]).T)
        near = (apart <= 1.5 * _AROUND) & (size >= _CROWN)
        # A crown that reaches over from a stem farther off lies aside of this one, and around that one.
        rivals = near & ((apart <= _AROUND) | (aside < 0.5 * aside[k]))
        # Something has to carry the crown: most likely the stem that looks least like a pole.
        first = slender[k] <= slender[near & (apart <= _BESIDE_TRUNK)].min() and not hidden[k]
        alone = first and aside[k] < _CENTRED and aside[k] <= aside[rivals].min()
        if _OFFSET + slender[k] + (_FIRST if first else 0.0) > 0 and not alone:
            poles.append(stem)
    groups = [
        [stem for stem, b in zip(stems, beam, strict=True) if b == number] for number in np.unique(beam[beam >= 0])
    ]
    return poles, [legs for legs in groups if len(legs) > 1 and _spans(xyz[rest], legs)]


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
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.bool_], NDArray[np.int64]]:
    """Return the size of the crown around each stem, how far aside its middle lies, and whether it stands elsewhere.

    And, where it is no crown but the beam of a gantry or a mast's arm, low and at the top of the stem, its number; -1
    elsewhere.
    """
    piece = cluster(np.ascontiguousarray(places), tolerance=_JOINED)
    size, aside = np.zeros(len(stems), np.int64), np.zeros(len(stems))
    hidden, beam = np.zeros(len(stems), np.bool_), np.full(len(stems), -1)
    for k, stem in enumerate(stems):
        away = stem.away(places)
        here = (np.hypot(*away.T) <= _AROUND) & (places[:, 2] >= stem.low + 0.4 * (stem.high - stem.low))
        size[k] = here.sum()
        aside[k] = np.hypot(*away[here].mean(axis=0)) if here.any() else np.inf
        if not here.any():
            continue
        number = int(np.bincount(piece[here]).argmax())
        whole = piece == number
        hidden[k] = _stands(away, places[:, 2] - stem.low, whole)
        low, middle, high = np.quantile(places[here, 2], (0.15, 0.5, 0.95))
        flat = high - low < _BEAM and abs(middle - stem.high) < _BEAM
        if flat and whole.sum() >= _CROWN and size[k] >= _RESTS:
            beam[k] = number
    return size, aside, hidden, beam


def _slender(stem: Stem, xyz: NDArray[np.float64], counts: NDArray[np.int64]) -> float:
    """Return how much straighter, more upright and thinner a stem is than another."""
    bend, spread = _shape(stem, xyz, counts)
    lean = float(np.hypot(*stem.slope))
    return _BEND * np.log(_LEAST + bend) + _LEAN * np.log(_LEAST + lean) + _SPREAD * spread


def _shape(stem: Stem, xyz: NDArray[np.float64], counts: NDArray[np.int64]) -> tuple[float, float]:
    """Return how far the sections of a stem lie off a straight line, and how far points spread in the thin ones.

    Points are counted, not voxels, so that leaves around a stem hardly matter.
    """
    height = xyz[:, 2] - stem.low
    rows = np.flatnonzero((height >= _BASE) & (xyz[:, 2] <= stem.high))
    rows = rows[stem.distance(xyz[rows]) <= _INSIDE]
    _, section = np.unique(np.floor(height[rows] / SLAB), return_inverse=True)
    if len(rows) == 0 or section.max() + 1 < _SECTIONS:
        return _UNMEASURED
    mass = np.bincount(section, counts[rows])
    middle = np.column_stack([np.bincount(section, counts[rows] * xyz[rows, axis]) / mass for axis in range(3)])
    off = ((xyz[rows, :2] - middle[section, :2]) ** 2).sum(axis=1)
    spread = np.sqrt(np.bincount(section, counts[rows] * off) / mass)
    return float(np.median(_deviations(middle))), float(np.quantile(spread, 0.25))


def _deviations(middle: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the distances of places from the upright line of least deviations through them."""
    design = np.column_stack([np.ones(len(middle)), middle[:, 2] - middle[:, 2].mean()])
    weight = np.ones((len(middle), 1))
    for _ in range(_ROUNDS):
        line, *_ = np.linalg.lstsq(design * weight, middle[:, :2] * weight, rcond=None)
        off = np.hypot(*(middle[:, :2] - design @ line).T)
        weight = 1.0 / np.sqrt(np.maximum(off, _LEVELLED))[:, None]
    return off


def _stands(away: NDArray[np.float64], height: NDArray[np.float64], crown: NDArray[np.bool_]) -> bool:
    """Tell whether a crown comes down to the ground beside a line: then a stem that was not found carries it."""
    near = crown & (np.hypot(*away.T) <= _AROUND)
    if not near.any() or height[near].min() > _FOOT:
        return False
    foot = away[near & (height <= height[near].min() + _FOOT)]
    # A wall or a hedge that the crown touches is no stem.
    return bool(np.hypot(*foot.mean(axis=0)) >= _BESIDE and np.ptp(foot, axis=0).max() <= _STEM)

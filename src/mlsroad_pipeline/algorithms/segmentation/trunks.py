"""Which stems carry a crown: trunks, as against poles that stand in one.

Where there is a crown around a stem, six things tell: poles are upright, straight and thin, the crown's middle lies
beside them, another stem is nearer to it, and one is beside them that looks less like a pole. Their weights are those
of a logistic regression on the stems of the training streets of the study of Yu et al. 2016
(docs/methods/segmentation.md).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.segmentation.euclidean import cluster
from mlsroad_pipeline.algorithms.segmentation.stems import RADIUS, SLAB, Stem, measure_sections

_AROUND = 2.0  # of an axis, where a crown is looked for, metres
_CROWN = 300  # voxels that make a crown
_JOINED = 0.25  # voxels of one crown are this close, metres
_FOOT, _BESIDE, _STEM = 0.7, 0.3, 1.2  # of a stem that was not found: height of its foot, distance, width, metres
_ASIDE = 0.7  # a crown whose middle is farther from an axis grows on another stem, metres
_CENTRED = 0.1  # and one whose middle is nearer stands around its own stem, metres
_BESIDE_TRUNK = 2.5  # the farthest pole from the trunk whose crown it stands in, metres
_OUTSIDE, _CLEAR = 0.6, 0.35  # metres around a section that is measured, and voxels there over its own
_INSIDE = 0.3  # of an axis, what is measured of a section, metres
_SECTIONS = 4  # that a stem is measured by
_OFFSET, _NO_CARRIER, _FIRST = 4.0, 1.0, -2.4  # of likeness
_LEAN, _BEND, _WIDTH, _MIDDLE = -67.0, -38.8, -9.6, 2.2  # of likeness, per slope and metre
_UNMEASURED = 0.05, 0.3  # bend and width of a stem that is nowhere clear, metres


def without_crown(xyz: NDArray[np.float64], stems: list[Stem]) -> list[Stem]:
    """Return the stems that no crown grows on: there is little around, or they look like poles.

    Parameters
    ----------
    xyz : ndarray of float64, shape (v, 3)
        Voxels of a cluster, metres, z up.
    stems : list of Stem
        The stems in it.

    Returns
    -------
    list of Stem
        The poles among them.
    """
    if not stems:
        return []
    rest = np.ones(len(xyz), np.bool_)
    for stem in stems:
        rest &= (stem.distance(xyz) > RADIUS) | (xyz[:, 2] > stem.high + SLAB)
    size, aside, hidden = _crowns(xyz[rest], stems)
    slender = np.array(
        [_slender(stem, xyz) + _MIDDLE * min(off, _AROUND) for stem, off in zip(stems, aside, strict=True)]
    )
    foot = np.array([stem.base + stem.slope * stem.low for stem in stems])
    poles = []
    for k, stem in enumerate(stems):
        apart = np.hypot(*(foot - foot[k]).T)
        near = (apart <= 1.5 * _AROUND) & (size >= _CROWN)
        # A crown that reaches over from a stem farther off lies aside of this one, and around that one.
        rivals = near & ((apart <= _AROUND) | (aside < 0.5 * aside[k]))
        if size[k] < _CROWN:
            poles.append(stem)
            continue
        carries = aside[k] < _ASIDE and aside[k] <= aside[rivals].min() and not hidden[k]
        likeness = _OFFSET + slender[k] + (0.0 if carries else _NO_CARRIER)
        # Something has to carry the crown: most likely the stem that looks least like a pole.
        first = slender[k] <= slender[near & (apart <= _BESIDE_TRUNK)].min() and not hidden[k]
        if likeness + (_FIRST if first else 0.0) > 0 and not (carries and aside[k] < _CENTRED):
            poles.append(stem)
    return poles


def _crowns(
    places: NDArray[np.float64], stems: list[Stem]
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.bool_]]:
    """Return the size of the crown around each stem, how far aside its middle lies, and whether it stands elsewhere."""
    piece = cluster(np.ascontiguousarray(places), tolerance=_JOINED)
    size, aside = np.zeros(len(stems), np.int64), np.zeros(len(stems))
    hidden = np.zeros(len(stems), np.bool_)
    for k, stem in enumerate(stems):
        away = stem.away(places)
        here = (np.hypot(*away.T) <= _AROUND) & (places[:, 2] >= stem.low + 0.4 * (stem.high - stem.low))
        size[k] = here.sum()
        aside[k] = np.hypot(*away[here].mean(axis=0)) if here.any() else np.inf
        hidden[k] = here.any() and _stands(away, places[:, 2] - stem.low, piece == np.bincount(piece[here]).argmax())
    return size, aside, hidden


def _slender(stem: Stem, xyz: NDArray[np.float64]) -> float:
    """Return how much more upright, straight and thin a stem is than another."""
    bend, width = _shape(stem, xyz)
    return _LEAN * float(np.hypot(*stem.slope)) + _BEND * bend + _WIDTH * width


def _shape(stem: Stem, xyz: NDArray[np.float64]) -> tuple[float, float]:
    """Return how far the sections of a stem lie off a straight line, and how wide they are, where it stands clear."""
    distance = stem.distance(xyz)
    slab = np.floor((xyz[:, 2] - stem.low) / SLAB).astype(np.int64)
    near = np.flatnonzero((distance <= _OUTSIDE) & (xyz[:, 2] >= stem.low) & (xyz[:, 2] <= stem.high))
    inside = near[distance[near] <= _INSIDE]
    n = int(slab[near].max(initial=0)) + 1
    own = np.bincount(slab[inside], minlength=n)
    other = np.bincount(slab[near], minlength=n) - own
    clear = (own > 1) & (other <= _CLEAR * own)
    if clear.sum() < _SECTIONS:
        return _UNMEASURED
    rows = inside[clear[slab[inside]]]
    section = np.unique(slab[rows], return_inverse=True)[1].astype(np.int64)
    middle, width, _ = measure_sections(xyz[rows], section)
    design = np.column_stack([np.ones(len(middle)), middle[:, 2]])
    line, *_ = np.linalg.lstsq(design, middle[:, :2], rcond=None)
    bend = np.sqrt(((middle[:, :2] - design @ line) ** 2).sum(axis=1).mean())
    return float(bend), float(np.median(width))


def _stands(away: NDArray[np.float64], height: NDArray[np.float64], crown: NDArray[np.bool_]) -> bool:
    """Tell whether a crown comes down to the ground beside a line: then a stem that was not found carries it."""
    near = crown & (np.hypot(*away.T) <= _AROUND)
    if not near.any() or height[near].min() > _FOOT:
        return False
    foot = away[near & (height <= height[near].min() + _FOOT)]
    # A wall or a hedge that the crown touches is no stem.
    return bool(np.hypot(*foot.mean(axis=0)) >= _BESIDE and np.ptp(foot, axis=0).max() <= _STEM)

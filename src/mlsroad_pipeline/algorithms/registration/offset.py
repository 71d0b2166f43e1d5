"""Offset between two recordings of one place, from the surfaces that both have.

The height is found first, from the ground of cells of both; then the place in plan, from votes of pairs of upright
patches and of poles within `LARGEST_PLAN`. From there patches are matched with the nearest of a like direction, and the
offset is the robust least-squares solution along their normals, with a decreasing reach (point-to-plane ICP).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.core.validation import check_positive
from mlsroad_pipeline.algorithms.geometry.sorting import rank_integers
from mlsroad_pipeline.algorithms.registration.coarse import coarse_height, coarse_plans, seam_height
from mlsroad_pipeline.algorithms.registration.surfaces import Surfaces, find_surfaces, turn_of

LARGEST_PLAN, LARGEST_HEIGHT = 2.2, 50.0
"""Largest offsets that are searched for, metres."""

REACHES = (0.6, 0.4, 0.25, 0.15, 0.1, 0.1)
"""Largest distance along the normal of patches that match, metres, per step."""

ALIKE = 0.95
"""Least cosine between the normals of patches that match."""

N_FEW, N_MANY = 700, 2000
"""Largest number of surfaces of each kind that choose among the starts, and that are matched from the best one."""

POLE_WEIGHT = 4.0
"""Weight of a piece of a pole; that of a patch is 1."""

CLUSTER, CLUSTER_ERROR = 4.0, 0.02
"""Edge length in plan of the places that count as one measurement each, metres, and its standard error."""

MOST_ERROR = 0.015
"""Largest standard error of an offset that counts as measured, metres."""

LEAST_TURN = np.radians(0.05)
"""Least turn that counts, radians: passes of one survey differ by less where a calibration is good."""

FEWEST_PLACES = 4
"""Fewest places with matched surfaces."""

FLOOR = 0.003
"""Least standard error, metres."""


@dataclass(frozen=True)
class Offset:
    """Shift and turn that move one recording onto another, with standard errors; metres and radians.

    A shift is NaN, and so is its error, in plan or in height where nothing measures it. The turn, about the vertical
    through `pivot` and before the shift, is 0 unless significant. A `seam` is where recordings only border on each
    other, and the height is that of the ground on both sides.
    """

    shift: NDArray[np.float64]
    error: NDArray[np.float64]
    n_surfaces: int
    heading: float
    heading_error: float
    pivot: NDArray[np.float64]
    seam: bool = False

    def apply(self, xyz: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return points of the moving recording at their place in the fixed one; unmeasured shifts count as zero."""
        return (xyz - self.pivot) @ turn_of(self.heading).T + self.pivot + np.nan_to_num(self.shift)


def find_offset(
    fixed: NDArray[np.floating],
    moving: NDArray[np.floating],
    *,
    heading: bool = True,
    largest_plan: float = LARGEST_PLAN,
    largest_height: float = LARGEST_HEIGHT,
) -> Offset | None:
    """Return the offset of a recording from another of the same place, or None where nothing measures it.

    Points are relative to one origin near them; ten per cell of 0.5 m suffice. The plan is measured where upright
    surfaces of two directions, or poles, lie at four places at least. Moving objects should be left out where they are
    known.

    Examples
    --------
    >>> grid = np.mgrid[0:60, 0:60].reshape(2, -1).T * 0.1
    >>> ground = np.column_stack([grid, np.zeros(len(grid))])
    >>> found = find_offset(ground, ground + [0, 0, -0.5])
    >>> found.shift.round(3)
    array([nan, nan, 0.5])
    """
    return offset_of_surfaces(
        find_surfaces(fixed),
        find_surfaces(moving),
        heading=heading,
        largest_plan=largest_plan,
        largest_height=largest_height,
    )


def offset_of_surfaces(
    fixed: Surfaces,
    moving: Surfaces,
    *,
    heading: bool = True,
    largest_plan: float = LARGEST_PLAN,
    largest_height: float = LARGEST_HEIGHT,
) -> Offset | None:
    """Return what `find_offset` does, from surfaces that are known."""
    check_positive(largest_plan, "largest_plan")
    check_positive(largest_height, "largest_height")
    height = coarse_height(fixed, moving, largest_height)
    if height is None:
        seam = seam_height(fixed, moving, largest_height)
        return None if seam is None else _seam(seam, moving)
    lifted = moving.moved(np.array([0.0, 0.0, height]))
    few, best, most = moving.thinned(N_FEW), None, -1.0
    starts = [np.array([*plan, height]) for plan in coarse_plans(fixed, lifted, largest_plan)]
    for start in starts if len(starts) > 1 else []:
        fit = _refine(fixed, few, start, REACHES[:4], heading)
        if fit is not None and fit.score > most:
            best, most = start, fit.score
    found = _refine(fixed, moving.thinned(N_MANY), starts[0] if best is None else best, REACHES, heading)
    return None if found is None else Offset(*found[:-1])


def _seam(seam: tuple[float, float, int], moving: Surfaces) -> Offset:
    height, error, n = seam
    empty = np.full(2, np.nan)
    pivot = moving.centre.mean(axis=0)
    return Offset(np.append(empty, height), np.append(empty, error), n, 0.0, np.nan, pivot, seam=True)


class _Fit(NamedTuple):
    """Fields of `Offset` from one start; `score` is the weight of the surfaces that agree within 5 cm in plan."""

    shift: NDArray[np.float64]
    error: NDArray[np.float64]
    n: int
    turn: float
    turn_error: float
    pivot: NDArray[np.float64]
    score: float


class _Rows(NamedTuple):
    """Equations: `factors` times the unknowns equals `rest`; weights, and the place that each row lies in."""

    factors: NDArray[np.float64]
    rest: NDArray[np.float64]
    weight: NDArray[np.float64]
    place: NDArray[np.int64]


class _Solution(NamedTuple):
    value: NDArray[np.float64]
    error: NDArray[np.float64]
    n: int  # rows within reach
    n_close: float  # weight of rows within 5 cm


def _refine(
    fixed: Surfaces, moving: Surfaces, start: NDArray[np.float64], reaches: tuple[float, ...], heading: bool
) -> _Fit | None:
    """Return the offset from a start, by turns for plan and height."""
    pivot = _middle(moving)
    shift, turn = start.copy(), 0.0
    level = _Kind(fixed, fixed.level), _Kind(moving, moving.level)
    upright = _Kind(fixed, fixed.upright), _Kind(moving, moving.upright)
    plan: _Solution | None = None
    turned: _Solution | None = None
    up: _Solution | None = None
    for number, reach in enumerate(reaches):
        placed = moving.moved(shift, turn, pivot)
        rows = _plan_rows(upright, fixed, placed, pivot + shift, reach)
        turned = _solve(rows, reach) if heading and number > 1 else None
        plan = _solve(rows._replace(factors=rows.factors[:, :2]), reach)
        if turned is not None and _has_turn(turned, turn):
            shift[:2] += turned.value[:2]
            turn += turned.value[2]
            plan = turned
        elif plan is not None:
            shift[:2] += plan.value[:2]
        up = _solve(_height_rows(level, moving.moved(shift, turn, pivot), reach), reach)
        shift[2] += 0.0 if up is None else up.value[0]
    if plan is None or not (plan.error[:2] <= MOST_ERROR).all():  # a grade would turn an unknown plan into height
        plan, shift, turn = None, np.array([0.0, 0.0, start[2]]), 0.0
        for reach in reaches:
            up = _solve(_height_rows(level, moving.moved(shift), reach), reach)
            shift[2] += 0.0 if up is None else up.value[0]
    return _fit_of(shift, turn, turned, plan, up, pivot)


def _middle(surfaces: Surfaces) -> NDArray[np.float64]:
    both = np.concatenate([surfaces.centre[surfaces.upright], surfaces.pole])
    return (both if len(both) else surfaces.centre).mean(axis=0)


def _has_turn(found: _Solution, turn: float) -> bool:
    """Return whether a turn is significant: three standard errors and `LEAST_TURN`."""
    return bool(abs(turn + found.value[2]) > max(3 * found.error[2], LEAST_TURN))


def _fit_of(
    shift: NDArray[np.float64],
    turn: float,
    turned: _Solution | None,
    plan: _Solution | None,
    up: _Solution | None,
    pivot: NDArray[np.float64],
) -> _Fit | None:
    """Return the fit with NaN for what was not measured, or None if nothing was."""
    error = np.full(3, np.nan)
    n, score = 0, 0.0
    if plan is not None:
        error[:2], n, score = plan.error[:2], plan.n, plan.n_close
    if up is not None and up.error[0] <= MOST_ERROR:
        error[2], n = up.error[0], n + up.n
    if not n:
        return None
    measured = np.isfinite(error)
    turn_error = np.nan if turned is None or not measured[0] else float(turned.error[2])
    turn = turn if measured[0] else 0.0
    return _Fit(np.where(measured, shift, np.nan), error, n, turn, turn_error, pivot, score)


class _Kind:
    """Patches of one kind, with a tree over their centres."""

    def __init__(self, surfaces: Surfaces, chosen: NDArray[np.bool_]) -> None:
        self.chosen = chosen
        self.centre, self.normal = surfaces.centre[chosen], surfaces.normal[chosen]
        self.tree = cKDTree(self.centre) if len(self.centre) else None


def _matches(
    fixed: _Kind, centre: NDArray[np.float64], normal: NDArray[np.float64], reach: float
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return pairs of patches: for each, the nearest of the fixed ones with a like normal and within reach."""
    none = np.zeros(0, dtype=np.int64)
    if fixed.tree is None or not len(centre):
        return none, none
    distance, near = fixed.tree.query(centre, k=min(4, len(fixed.centre)), distance_upper_bound=0.6 + reach)
    distance, near = distance.reshape(len(centre), -1), near.reshape(len(centre), -1)
    known = np.isfinite(distance)
    other = np.where(known, near, 0)
    like = known & (np.abs(np.einsum("ij,ikj->ik", normal, fixed.normal[other])) > ALIKE)
    like &= np.abs(np.einsum("ikj,ikj->ik", fixed.normal[other], centre[:, None] - fixed.centre[other])) <= reach
    rows = np.flatnonzero(like.any(axis=1))
    return rows, other[rows, like[rows].argmax(axis=1)]


def _plan_rows(
    upright: tuple[_Kind, _Kind], fixed: Surfaces, placed: Surfaces, pivot: NDArray[np.float64], reach: float
) -> _Rows:
    chosen = upright[1].chosen
    rows, other = _matches(upright[0], placed.centre[chosen], placed.normal[chosen], reach)
    at = placed.centre[chosen][rows]
    normal = upright[0].normal[other]
    rest = np.einsum("ij,ij->i", normal, upright[0].centre[other] - at)
    poles, theirs = _pole_matches(fixed.pole, placed.pole, reach)
    eye = np.repeat(np.eye(2), len(poles), axis=0)
    where = np.concatenate([at, placed.pole[poles], placed.pole[poles]])
    flat = np.concatenate([normal[:, :2], eye])
    arm = where[:, :2] - pivot[:2]
    factors = np.column_stack([flat, flat[:, 1] * arm[:, 0] - flat[:, 0] * arm[:, 1]])
    gap = (fixed.pole[theirs] - placed.pole[poles])[:, :2]
    weight = np.concatenate([np.ones(len(rows)), np.full(2 * len(poles), POLE_WEIGHT)])
    return _Rows(factors, np.concatenate([rest, gap[:, 0], gap[:, 1]]), weight, _places(where))


def _pole_matches(
    fixed: NDArray[np.float64], moving: NDArray[np.float64], reach: float
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return pairs of pieces of poles, nearest in plan within the reach and at like heights."""
    if not len(fixed) or not len(moving):
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
    scale = np.array([1.0, 1.0, 0.1])  # height counts little: pieces of one pole lie above each other
    distance, near = cKDTree(fixed * scale).query(moving * scale)
    found = (np.hypot(*(fixed[near] - moving)[:, :2].T) <= reach) & (distance <= reach + 0.06)
    return np.flatnonzero(found), near[found]


def _height_rows(level: tuple[_Kind, _Kind], placed: Surfaces, reach: float) -> _Rows:
    chosen = level[1].chosen
    rows, other = _matches(level[0], placed.centre[chosen], placed.normal[chosen], reach)
    at, normal = placed.centre[chosen][rows], level[0].normal[other]
    rest = np.einsum("ij,ij->i", normal, level[0].centre[other] - at) / normal[:, 2]
    return _Rows(np.ones((len(rows), 1)), rest, np.ones(len(rows)), _places(at))


def _places(where: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return the number of the place in plan of each row."""
    if not len(where):
        return np.zeros(0, dtype=np.int64)
    index = np.floor(where[:, :2] / CLUSTER).astype(np.int64)
    return rank_integers((index[:, 0] << 32) + index[:, 1])[1]


def _solve(rows: _Rows, reach: float) -> _Solution | None:
    """Return the robust solution (Tukey's weights) and its standard errors, or None with too few places."""
    n_places = int(rows.place.max(initial=-1)) + 1
    if n_places < FEWEST_PLACES or len(rows.rest) < 2 * FEWEST_PLACES:
        return None
    value = np.zeros(rows.factors.shape[1])
    limit, weight = reach, rows.weight
    for _ in range(6):
        off = rows.rest - rows.factors @ value
        limit = float(np.clip(4 * 1.4826 * np.median(np.abs(off)), 0.02, reach))
        weight = rows.weight * np.maximum(0.0, 1 - (off / limit) ** 2) ** 2
        weighted = rows.factors * weight[:, None]
        normal = weighted.T @ rows.factors
        if np.linalg.cond(normal) > 1e8:
            return None
        value = np.linalg.solve(normal, weighted.T @ rows.rest)
    off = rows.rest - rows.factors @ value
    return _Solution(
        value, _errors(rows, weight, off), int((weight > 0).sum()), float(weight[np.abs(off) < 0.05].sum())
    )


def _errors(rows: _Rows, weight: NDArray[np.float64], off: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return standard errors: rows of one place err together, and a place is no better than `CLUSTER_ERROR`."""
    n, k = int(rows.place.max()) + 1, rows.factors.shape[1]
    weighted = rows.factors * weight[:, None]
    inverse = np.linalg.pinv(weighted.T @ rows.factors)
    sums = np.column_stack([np.bincount(rows.place, weighted[:, j] * off, n) for j in range(k)])
    sandwich = inverse @ (sums.T @ sums) @ inverse
    total = np.maximum(np.bincount(rows.place, weight, n), 1e-12)
    share = weight / total[rows.place]
    alone = np.linalg.pinv((rows.factors * share[:, None]).T @ rows.factors) * CLUSTER_ERROR**2
    return np.maximum(np.sqrt(np.maximum(np.diag(sandwich), np.diag(alone))), FLOOR if k < 3 else [FLOOR, FLOOR, 0.0])

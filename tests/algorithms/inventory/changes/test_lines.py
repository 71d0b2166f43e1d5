"""States of planted lines of two surveys, and what their points show."""

import numpy as np
import pytest

from mlsroad_pipeline.algorithms.inventory.changes.lines import (
    ABSENT,
    SHOWN,
    UNSEEN,
    Lines,
    barrier_seen,
    compare_lines,
    contrast_of,
    length_of,
    offsets_from,
    places_on,
    same_measure,
    step_across,
    with_evidence,
)
from mlsroad_pipeline.algorithms.inventory.changes.objects import GONE, NEW, UNCHANGED, UNSEEN_FIRST, UNSEEN_SECOND


def line(*vertices):
    return np.array([(*vertex, 30.0) for vertex in vertices], dtype=np.float64)


def parts_of(first, second):
    parts = compare_lines(*(Lines([kind for kind, _ in own], [at for _, at in own]) for own in (first, second)))
    return [(part.kind, part.state, part.first, part.second, round(length_of(part.places))) for part in parts]


def test_a_line_is_unchanged_where_its_kind_is_listed_again():
    first = [("kerb", line((0, 0), (40, 0))), ("kerb", line((0, 8), (10, 8)))]
    second = [("kerb", line((0, 0.2), (18, 0.2), (25, 0.2))), ("wire", line((0, 8), (10, 8)))]
    assert parts_of(first, second) == [
        ("kerb", UNCHANGED, 0, 0, 25),
        ("wire", "", -1, 1, 10),
        ("kerb", "", 0, -1, 14),
        ("kerb", "", 1, -1, 10),
    ]
    assert parts_of([], []) == [] and len(parts_of(first, [])) == 2


def test_markings_of_two_kinds_at_one_place_are_one():
    first, second = [("lane_line", line((0, 0), (6, 0)))], [("other_marking", line((0, 0.1), (6, 0.1)))]
    assert parts_of(first, second) == [("other_marking", UNCHANGED, 0, 0, 6)]


def test_short_gaps_belong_to_the_line_around_them():
    first = [("kerb", line((0, 0), (20, 0))), ("kerb", line((21.5, 0), (40, 0)))]
    second = [("kerb", line((0, 0), (40, 0)))]
    assert [(state, length) for _, state, _, _, length in parts_of(first, second)] == [(UNCHANGED, 40)]


@pytest.mark.parametrize(
    ("found", "before", "after"),
    [(SHOWN, UNCHANGED, UNCHANGED), (ABSENT, GONE, NEW), (UNSEEN, UNSEEN_SECOND, UNSEEN_FIRST)],
)
def test_the_points_of_the_other_survey_decide_about_the_other_parts(found, before, after):
    lines, none = Lines(["kerb"], [line((0, 0), (9, 0))]), Lines([], [])
    assert with_evidence(compare_lines(lines, none)[0], found).state == before
    part = with_evidence(compare_lines(none, lines)[0], found)
    assert part.state == after and "first survey" in part.reason


def test_offsets_are_those_across_the_line():
    places = places_on(line((0, 0), (5, 5)))
    aside = np.array([[2.5, 2.5, 0], [2.0, 3.0, 0], [3.0, 2.0, 0], [9.0, 9.0, 0]])
    assert offsets_from(aside, places) == pytest.approx([0, np.sqrt(0.5), -np.sqrt(0.5), np.inf])


def test_a_step_and_a_contrast_are_measured_across():
    rng, places = np.random.default_rng(1), places_on(line((0, 0), (8, 0)))
    road = np.column_stack([rng.uniform(0, 8, 4000), rng.uniform(-1, 1, 4000), rng.normal(30, 0.01, 4000)])
    kerb = road + np.column_stack([np.zeros((4000, 2)), 0.12 * (road[:, 1] > 0)])
    assert step_across(kerb, places) == pytest.approx(0.12, abs=0.01)
    assert abs(step_across(road, places)) < 0.01 and np.isnan(step_across(road[:9], places))
    painted = np.where(np.abs(road[:, 1] - 0.1) < 0.06, 0.6, 0.2).astype(np.float32)  # 0.1 m aside of the places
    assert contrast_of(road, painted, places, 0.12) == pytest.approx(2.0, abs=0.1)
    assert abs(contrast_of(road, np.full(4000, 0.2, np.float32), places, 0.12)) < 1e-6
    assert np.isnan(contrast_of(road, np.full(4000, np.nan, np.float32), places, 0.12))


@pytest.mark.parametrize(
    ("own", "other", "found"),
    [(0.12, 0.1, SHOWN), (0.12, 0.02, ABSENT), (-0.12, 0.12, ABSENT), (0.12, np.nan, UNSEEN), (0.02, 0.0, UNSEEN)],
)
def test_a_line_without_evidence_of_its_own_proves_nothing(own, other, found):
    assert same_measure(own, other, 0.04) == found


@pytest.mark.parametrize(
    ("height", "ground", "found"),
    [(1.2, True, SHOWN), (1.2, False, SHOWN), (None, True, ABSENT), (None, False, UNSEEN), (1.2, "gap", ABSENT)],
)
def test_points_above_the_ground_show_a_barrier_and_ground_alone_disproves_it(height, ground, found):
    rng = np.random.default_rng(8)
    places = places_on(np.array([[0.0, 0, 0], [10, 0, 0]]))
    plain = np.column_stack([rng.uniform(0, 10, 4000), rng.uniform(-1, 1, 4000), np.zeros(4000)])
    plain = plain if ground else plain[:0]
    long = 3.0 if ground == "gap" else 10.0
    fence = np.column_stack([rng.uniform(0, long, 300), rng.normal(0, 0.05, 300), rng.uniform(0, height or 1, 300)])
    fence = fence if height else fence[:0]
    points = np.concatenate([plain, fence])
    assert barrier_seen(points, np.arange(len(points)) < len(plain), places) == found

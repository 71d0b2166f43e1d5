"""Bases of GPS times: the end of a week, whole weeks, 1e9 seconds."""

from datetime import UTC, datetime

import numpy as np
import pytest

from mlsroad_pipeline.algorithms.inventory.objects.sightings import time_passes
from mlsroad_pipeline.algorithms.scenes.weeks import ADJUSTED, WEEK, base_shift, continued, since_1980, utc_of


def test_times_go_on_after_the_end_of_a_week():
    time = np.array([604_790.0, 604_799.5, 0.5, 12.0])
    np.testing.assert_allclose(continued(time), [604_790.0, 604_799.5, WEEK + 0.5, WEEK + 12])


@pytest.mark.parametrize(
    "time",
    [[0.0, 10.0], [604_700.0, 604_799.0], [100_000.0, 604_799.0], [0.0, 2e5, 4e5, 604_799.0], [-5.0, 604_799.0]],
)
def test_other_times_stay(time):
    np.testing.assert_array_equal(continued(np.array(time)), time)


def test_a_pass_over_the_end_of_a_week_is_one():
    second = np.array([604_790, 604_799, 0, 9, 700], dtype=np.int32)
    assert time_passes(second).tolist() == [0, 0, 0, 0, 1]


@pytest.mark.parametrize(
    ("base", "points"),
    [
        (1000.0, 2_100 * WEEK + 1000 - ADJUSTED),  # seconds of the week, adjusted times
        (1000.0, 2_100 * WEEK + 1000),  # seconds of the week, seconds since 1980
        (1000.0, 1_500 * WEEK + 1000 - ADJUSTED),  # before September 2011: negative
        (2_100 * WEEK + 1000, 2_100 * WEEK + 1000 - ADJUSTED),  # since 1980, adjusted
        (2_100 * WEEK + 1000, 1000.0),
        (2_100 * WEEK + 1000 - ADJUSTED, 1000.0),
        (WEEK - 10, -10.0 + 0.0),
    ],
)
def test_a_trajectory_is_brought_to_the_base_of_the_points(base, points):
    time = base + np.arange(0.0, 100.0)
    assert time[0] + base_shift(time, points + 10, points + 60) == pytest.approx(points, abs=1e-3)


def test_times_that_no_base_explains_stay():
    assert base_shift(np.arange(100.0), 5_000.0, 6_000.0) == 0.0
    assert base_shift(np.arange(100.0), 90.0, 200.0) == 0.0


def test_times_of_every_base_with_a_date_have_their_utc():
    moment = datetime(2016, 12, 31, 23, 59, 59, tzinfo=UTC)  # the last second before the 18th leap second
    gps = moment.timestamp() - datetime(1980, 1, 6, tzinfo=UTC).timestamp() + 17
    assert since_1980(np.array([gps, gps - ADJUSTED])).tolist() == [gps, gps]
    assert utc_of(gps) == moment and utc_of(gps + 2).isoformat() == "2017-01-01T00:00:00+00:00"
    assert np.isnan(since_1980(np.array([0.0, WEEK, np.nan, 1.7e9]))).all()

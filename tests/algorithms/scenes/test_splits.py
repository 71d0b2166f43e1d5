"""Parts of a recording: disjoint, with gaps."""

import numpy as np
import pytest

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.scenes.splits import (
    check_splits_along,
    check_splits_sectors,
    select_along,
    select_sectors,
)


def test_along_takes_fractions_or_metres():
    station = np.array([-3.0, 0, 49, 50, 51, 99, 100, 104])
    assert select_along(station, length=100, along=[0, 0.5]).tolist() == [True] * 3 + [False] * 5
    assert select_along(station, length=100, along=[50, 100]).tolist() == [False] * 3 + [True] * 5
    assert select_along(station, length=100, along=[0, 0.5], gap=3).tolist() == [True] * 2 + [False] * 6
    assert select_along(station, length=100, along=[0.5, 1], gap=3).tolist() == [False] * 5 + [True] * 3


def ring(degrees):
    angle = np.radians(degrees)
    return np.column_stack([np.cos(angle), np.sin(angle), np.zeros(len(angle))]) * 10


def test_sectors_turn_counterclockwise_through_zero():
    xyz = ring([0, 59, 61, 180, 299, 301])
    assert select_sectors(xyz, sectors=[[300, 60]]).tolist() == [True, True, False, False, False, True]
    assert select_sectors(xyz, sectors=[[-60, 60]]).tolist() == [True, True, False, False, False, True]
    assert select_sectors(xyz, sectors=[[60, 200], [290, 300]]).tolist() == [False, False, True, True, True, False]
    assert select_sectors(xyz, sectors=[[0, 360]], gap_degrees=9).all()
    moved = select_sectors(xyz + np.array([5, 5, 5]), sectors=[[300, 60]], centre=[5, 5, 5])
    np.testing.assert_array_equal(moved, select_sectors(xyz, sectors=[[300, 60]]))


def test_gap_keeps_sectors_apart(rng):
    degrees = rng.uniform(0, 360, 2000)
    a = select_sectors(ring(degrees), sectors=[[0, 120]], gap_degrees=10)
    b = select_sectors(ring(degrees), sectors=[[120, 360]], gap_degrees=10)
    assert not (a & b).any()
    assert degrees[a].min() >= 5 and degrees[a].max() < 115
    assert degrees[b].min() >= 125 and degrees[b].max() < 355


def test_overlaps_are_errors():
    check_splits_along({"train": [0, 0.6], "test": [0.6, 1]}, length=50)
    with pytest.raises(ParameterError, match="'train' and 'test' share the trajectory from 25 m to 30 m"):
        check_splits_along({"test": [0.5, 1], "train": [0, 30]}, length=50)
    check_splits_sectors({"train": [[0, 180], [200, 220]], "test": [[180, 200], [220, 360]]})
    for overlapping in ([[350, 10]], [[100, 120]], [[-90, 270]]):
        with pytest.raises(ParameterError, match="'train' and 'test' overlap"):
            check_splits_sectors({"train": [[0, 180]], "test": overlapping})


@pytest.mark.parametrize("along", [[0.5, 0.5], [-1, 2], [0, np.nan], [1, 2, 3]])
def test_bad_parts(along):
    with pytest.raises(ParameterError, match="along must be"):
        select_along([0.0], length=10, along=along)


def test_bad_sectors_and_gaps():
    with pytest.raises(ParameterError, match="a sector must be"):
        select_sectors(ring([0.0]), sectors=[[10, 10]])
    with pytest.raises(ParameterError, match="gap_degrees must be"):
        select_sectors(ring([0.0]), sectors=[[10, 20]], gap_degrees=-1)
    with pytest.raises(ParameterError, match="gap must be"):
        select_along([0.0], length=10, along=[0, 1], gap=np.nan)

"""Surroundings of a supervoxel, in balls and in plan, against slow recounts and planted scenes."""

import numpy as np
import pytest
from references.accuracy import ball_features, footprint, voxel_centroids
from references.forest import voxel_partition

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.features.columns import FOOTPRINT_FEATURES, build_columns, describe_footprints
from mlsroad_pipeline.algorithms.features.supervoxel_features import compute_supervoxel_features
from mlsroad_pipeline.algorithms.features.surroundings import BALL_FEATURES, ball_feature_names, describe_balls

UTM = np.array([451_234.0, 5_412_987.0, 312.0])
RADII = (0.9, 2.0)


@pytest.fixture
def street(rng):
    """Sparse ground, a wall to the north, a crown, a pole, and one stray point."""
    ground = np.c_[rng.random((700, 2)) * [14, 10], rng.normal(0, 0.01, 700)]
    wall = np.c_[rng.random(300) * 14, rng.normal(9.5, 0.02, 300), rng.random(300) * 6]
    crown = rng.normal(size=(250, 3)) * 0.8 + [4, 4, 4]
    pole = np.c_[rng.normal(10.3, 0.02, (60, 2)) * [1, 0.4], rng.random(60) * 5]
    return np.vstack([ground, wall, crown, pole, [[30.0, 30.0, 9.0]]])


def balls_of(xyz, places, **kwargs):
    return describe_balls(xyz, np.asarray(places, dtype=float), radii=RADII, voxel_size=0.3, **kwargs)


def test_balls_are_those_of_numpy(street):
    places = np.vstack([street[::40] + 0.01, [[30.0, 30.0, 9.0]], [[60.0, 60.0, 0.0]]])
    found = balls_of(street, places)
    names = ball_feature_names(RADII)
    assert (found.shape, found.dtype) == ((len(places), len(names)), np.float32)
    assert names[: len(BALL_FEATURES)] == tuple(f"{name}_0.9m" for name in BALL_FEATURES)
    voxels, defined = voxel_centroids(street, 0.3), 0
    for place, row in zip(places, found, strict=True):
        got = dict(zip(names, row.tolist(), strict=True))
        for radius in RADII:
            expected = ball_features(voxels, place, radius)
            for name in BALL_FEATURES:
                if expected is None:
                    assert np.isnan(got[f"{name}_{radius:g}m"])
                else:
                    assert got[f"{name}_{radius:g}m"] == pytest.approx(expected[name], abs=2e-4), name
                    defined += 1
    assert defined > 500
    assert np.isnan(found[-2:]).all()  # the stray point is alone, and nothing is where the last ball is


def test_balls_do_not_depend_on_order_place_density_or_threads(street):
    places, before = street[::25], street.copy()
    base = balls_of(street, places)
    order = np.random.default_rng(1).permutation(len(street))
    assert balls_of(street[order], places).tobytes() == base.tobytes()
    assert balls_of(street, places, n_threads=2).tobytes() == base.tobytes()
    assert np.allclose(balls_of(street + UTM, places + UTM), base, atol=1e-3, equal_nan=True)
    assert np.array_equal(street, before)
    dense = np.vstack([street, np.repeat(street[street[:, 2] > 1], 4, axis=0)])
    single = voxel_centroids(street, 0.3)
    assert np.allclose(balls_of(single, places), balls_of(np.repeat(single, 3, axis=0), places), equal_nan=True)
    assert np.nanmax(np.abs(balls_of(dense, places) - base)) < 0.5  # voxels counted once; only their means move


def test_balls_tell_a_wall_from_a_crown_and_a_pole(street):
    names = ball_feature_names(RADII)
    wall, crown, pole = (
        dict(zip(names, row.tolist(), strict=True))
        for row in balls_of(street, [[7, 9.5, 3], [4, 4, 4], [10.3, 4.12, 2.5]])
    )
    assert wall["verticality_2m"] > 0.9 and wall["horizontal_linearity_2m"] > 0.9
    assert crown["horizontal_linearity_2m"] < 0.5
    assert pole["direction_z_0.9m"] > 0.9 and pole["linearity_0.9m"] > 0.9


@pytest.mark.parametrize("radius", [1.2, 4.0])
def test_footprints_are_those_of_a_slow_recount(street, radius):
    places = street[::45]
    raster = build_columns(street, cell_size=0.5, relief_radius=3.0)
    found = describe_footprints(places, raster, radius=radius)
    expected = np.array([footprint(street, place, radius, 0.5, 3.0) for place in places])
    assert found.dtype == np.float32
    assert np.allclose(found, expected, atol=1e-5, equal_nan=True)
    assert np.isfinite(found).all(axis=1).any() and np.isnan(found).any()


def test_footprints_tell_a_wall_a_pole_and_open_ground_apart():
    x, y = np.meshgrid(np.arange(0.25, 30, 0.5), np.arange(0.25, 30, 0.5))
    ground = np.c_[x.ravel(), y.ravel(), np.zeros(x.size)]
    wall = np.stack(np.meshgrid(np.arange(0.25, 30, 0.5), [5.25], np.arange(0.25, 8, 0.5)), -1).reshape(-1, 3)
    pole = np.c_[np.full((16, 2), 20.25), np.arange(0.25, 8, 0.5)]
    raster = build_columns(np.vstack([ground, wall, pole]), cell_size=0.5, relief_radius=3.0)
    places = np.array([[15.0, 5.25, 4.0], [20.25, 20.25, 0.0], [8.0, 25.0, 0.0]])
    on_wall, on_pole, open_ground = (
        dict(zip(FOOTPRINT_FEATURES, row.tolist(), strict=True))
        for row in describe_footprints(places, raster, radius=3.0)
    )
    assert (on_wall["footprint_linearity"], on_wall["footprint_width"]) == (1, 0)
    assert on_wall["footprint_height"] == 7  # 14 of its 16 slices are above the clearance of 1 m
    assert on_wall["footprint_top"] == 8
    assert np.isnan(on_pole["footprint_linearity"]) and on_pole["footprint_height"] == 7
    assert 0 < on_pole["footprint_cover"] < on_wall["footprint_cover"] < 0.2
    assert [open_ground[f"footprint_{name}"] for name in ("cover", "height", "top")] == [0, 0, 0]


def test_surroundings_join_the_features_undetrended_and_can_be_left_out(street):
    labels, adjacency = voxel_partition(street, 1.0)
    full = compute_supervoxel_features(street, labels, adjacency, ball_radii=[1.5], footprint_radii=[3])
    paper = compute_supervoxel_features(street, labels, adjacency, ball_radii=[], footprint_radii=[])
    added = [name for name in full.names if name not in paper.names]
    assert added == [*ball_feature_names([1.5]), *(f"{name}_3m" for name in FOOTPRINT_FEATURES)]
    kept = [full.names.index(name) for name in paper.names]
    assert np.array_equal(full.values[:, kept], paper.values, equal_nan=True)


@pytest.mark.parametrize(
    ("name", "value"), [("ball_radii", [1.0, 0.0]), ("footprint_radii", [-1.0]), ("ball_voxel_size", 0.0)]
)
def test_sizes_that_are_not_positive_are_named(street, name, value):
    labels, adjacency = voxel_partition(street, 1.0)
    with pytest.raises(ParameterError, match=name):
        compute_supervoxel_features(street, labels, adjacency, **{name: value})

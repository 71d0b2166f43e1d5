"""Features of supervoxels against references, planted scenes and their invariances."""

import numpy as np
import pytest
from references.forest import column_statistics, detrended, eigen_features, voxel_partition
from scipy.sparse import csr_array

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.features.columns import COLUMN_FEATURES, build_columns, describe_columns
from mlsroad_pipeline.algorithms.features.detrending import detrend, local_tendency
from mlsroad_pipeline.algorithms.features.eigen import SHAPE_FEATURES
from mlsroad_pipeline.algorithms.features.supervoxel_features import compute_supervoxel_features
from mlsroad_pipeline.algorithms.features.supervoxel_moments import describe_colour

UTM = np.array([451_234.0, 5_412_987.0, 312.0])


@pytest.fixture
def scene(rng):
    """A road, a wall and a pole in supervoxels of 0.6 m, with every column."""
    road = np.c_[rng.random((1200, 2)) * [4, 3], rng.normal(0, 0.005, 1200)]
    wall = np.c_[rng.random(600) * 4, rng.normal(3.1, 0.01, 600), rng.random(600) * 2.5]
    pole = np.c_[rng.normal(1.3, 0.02, (150, 2)), rng.random(150) * 2.5]
    xyz = np.vstack([road, wall, pole])
    labels, adjacency = voxel_partition(xyz, 0.6)
    rgb = rng.integers(0, 256, (len(xyz), 3)).astype(np.uint8)
    intensity = rng.random(len(xyz)).astype(np.float32)
    intensity[::5] = np.nan
    return xyz, labels, adjacency, rgb, intensity


def column(features, name):
    return features.values[:, features.names.index(name)]


def test_shape_and_orientation_are_those_of_the_supervoxels_points(scene):
    xyz, labels, adjacency, *_ = scene
    features = compute_supervoxel_features(xyz, labels, adjacency)
    checked = 0
    for s in range(adjacency.shape[0]):
        around = np.isin(labels, [s, *adjacency[[s]].indices])
        for points, suffix in ((xyz[labels == s], ""), (xyz[around], "_neighborhood")):
            if len(points) < 3:
                continue
            expected = eigen_features(points)
            for name in SHAPE_FEATURES:
                assert column(features, name + suffix)[s] == pytest.approx(expected[name], abs=1e-5)
            assert column(features, "verticality" + suffix)[s] == pytest.approx(expected["verticality"], abs=1e-4)
            z = abs(expected["direction"][2])
            assert column(features, "direction_z" + suffix)[s] == pytest.approx(z, abs=1e-4)
            checked += 1
    assert checked > 60
    assert np.array_equal(features.counts, np.bincount(labels))
    means = np.stack([np.bincount(labels, xyz[:, j]) / features.counts for j in range(3)], axis=1)
    assert np.allclose(features.centroids, means)


def test_columns_are_summarised_without_their_undefined_values(scene):
    xyz, labels, adjacency, rgb, intensity = scene
    heights = xyz[:, 2].astype(np.float32)
    heights[labels == 0] = np.nan
    features = compute_supervoxel_features(
        xyz, labels, adjacency, rgb=rgb, intensity=intensity, height_above_ground=heights
    )
    n = adjacency.shape[0]
    expected = column_statistics(intensity, labels, n)
    assert np.allclose(column(features, "intensity_mean"), expected[:, 0], atol=1e-6, equal_nan=True)
    assert np.allclose(column(features, "intensity_std"), expected[:, 1], atol=1e-6, equal_nan=True)
    expected = column_statistics(heights, labels, n)
    for j, name in enumerate(("mean", "std", "min", "max")):
        assert np.allclose(column(features, f"height_above_ground_{name}"), expected[:, j], atol=1e-5, equal_nan=True)
    assert np.isnan(column(features, "height_above_ground_mean")[0])
    expected = column_statistics(xyz[:, 2], labels, n)
    assert np.allclose(column(features, "height_range"), expected[:, 3] - expected[:, 2], atol=1e-6)
    assert np.allclose(column(features, "height_std"), expected[:, 1], atol=1e-6)


def test_colour_is_described_in_ycbcr():
    rgb = np.array([[255, 255, 255], [0, 0, 0], [255, 0, 0], [255, 0, 0]], np.uint8)
    values = describe_colour(rgb, np.array([0, 0, 1, 1], np.int32), 3)
    assert np.allclose(values[0], [0.5, 0, 0, 0.5, 0, 0], atol=1e-6)
    assert np.allclose(values[1], [0.299, -0.168736, 0.5, 0, 0, 0], atol=1e-6)
    assert np.isnan(values[2]).all()


def test_detrending_equals_equations_2_and_3(rng):
    dense = np.triu(rng.random((30, 30)) < 0.15, 1)
    dense[7] = dense[:, 7] = False  # a supervoxel without neighbours
    adjacency = csr_array((dense | dense.T).astype(np.int8))
    values = rng.normal(size=(30, 5)).astype(np.float32)
    values[rng.random(values.shape) < 0.2] = np.nan
    values[7] = [1, 2, 3, 4, np.nan]
    values[adjacency[[3]].indices, 2] = np.nan  # a feature that no neighbour has
    got = detrend(values, adjacency)
    assert np.allclose(got, detrended(values, adjacency), atol=1e-5, equal_nan=True)
    assert np.array_equal(got[7], [0, 0, 0, 0, np.nan], equal_nan=True)
    assert np.isnan(got[3, 2])
    assert np.isnan(local_tendency(values, adjacency)[7]).all()


def test_the_detrended_part_follows_the_plain_one(scene):
    xyz, labels, adjacency, *_ = scene
    paper = {"region": "own", "ball_radii": (), "footprint_radii": ()}
    plain = compute_supervoxel_features(xyz, labels, adjacency, detrend=False, **paper)
    both = compute_supervoxel_features(xyz, labels, adjacency, **paper)
    width = len(plain.names)
    assert both.names == (*plain.names, *(f"{name}_detrended" for name in plain.names))
    assert np.array_equal(both.values[:, :width], plain.values, equal_nan=True)
    assert np.allclose(both.values[:, width:], detrended(plain.values, adjacency), atol=1e-4, equal_nan=True)


def test_regions_and_optional_columns_decide_the_names(scene):
    xyz, labels, adjacency, rgb, intensity = scene
    around = compute_supervoxel_features(xyz, labels, adjacency, region="neighborhood", detrend=False)
    assert {f"{name}_neighborhood" for name in SHAPE_FEATURES} < set(around.names)
    assert not set(SHAPE_FEATURES) & set(around.names)
    coloured = compute_supervoxel_features(xyz, labels, adjacency, rgb=rgb, intensity=intensity)
    assert {"luma_mean", "intensity_std_detrended"} < set(coloured.names)
    assert len(set(coloured.names)) == coloured.values.shape[1]
    assert not any("luma" in name or "intensity" in name for name in around.names)


def columns_of(xyz, places, **kwargs):
    raster = build_columns(xyz, cell_size=0.5, relief_radius=5.0, **kwargs)
    values = describe_columns(np.asarray(places, dtype=float), raster)
    return [dict(zip(COLUMN_FEATURES, row, strict=True)) for row in values]


def test_columns_tell_a_pole_a_wire_and_a_wall_apart():
    x, y = np.meshgrid(np.arange(0.25, 20, 0.5), np.arange(0.25, 20, 0.5))
    ground = np.c_[x.ravel(), y.ravel(), np.zeros(x.size)]
    pole = np.c_[np.full((60, 2), 5.25), np.linspace(0, 6, 60)]
    wire = np.c_[np.linspace(0, 20, 200), np.full(200, 10.25), np.full(200, 8.25)]
    wall = np.stack(np.meshgrid(np.arange(0, 20, 0.25), [15.25], np.arange(0, 10, 0.25)), -1).reshape(-1, 3)
    xyz = np.vstack([ground, pole, wire, wall])
    places = [[5.25, 5.25, 3.2], [10.25, 10.25, 8.25], [10.25, 15.25, 4.1], [10.25, 5.25, 0.0]]
    on_pole, on_wire, on_wall, on_ground = columns_of(xyz, places)
    assert on_pole["column_extent"] == pytest.approx(6)
    assert on_pole["height_above_lowest"] == pytest.approx(3.2)
    assert on_pole["height_below_column_top"] == pytest.approx(2.8)
    assert (on_pole["gap_below"], on_pole["gap_above"], on_pole["run_extent"]) == (0, 0, 6.5)
    assert on_pole["column_fill"] == 1
    assert (on_pole["cover_near"], on_pole["cover_far"]) == (pytest.approx(1 / 25), pytest.approx(1 / 121))
    # Slice 16 holds the wire, slice 0 the ground: fifteen empty slices lie between.
    assert on_wire["gap_below"] == 7.5
    assert on_wire["column_fill"] == pytest.approx(2 / 17)
    assert (on_wire["cover_near"], on_wire["cover_far"]) == (pytest.approx(5 / 25), pytest.approx(11 / 121))
    assert (on_wall["gap_below"], on_wall["cover_far"]) == (0, pytest.approx(11 / 121))
    assert on_wall["column_extent"] == pytest.approx(9.75)
    assert on_ground["cover_near"] == 1
    assert (on_ground["gap_above"], on_ground["run_extent"], on_ground["column_extent"]) == (0, 0.5, 0)


def test_columns_on_a_slope_hang_on_their_own_ground():
    x, y = np.meshgrid(np.arange(0.25, 60, 0.5), np.arange(0.25, 6, 0.5))
    slope = np.c_[x.ravel(), y.ravel(), x.ravel()]  # 45 degrees up to 60 m, beyond 64 slices of 0.5 m
    wire = np.array([[50.25, 3.25, 60.25]])
    (on_wire,) = columns_of(np.vstack([slope, wire]), wire)
    # In the block of 3 x 3 cells the slope reaches 50.75 m (slice 101), and the wire is in slice 120.
    assert on_wire["gap_below"] == pytest.approx(9)
    assert on_wire["height_above_lowest"] == pytest.approx(60.25 - 45.25)


def test_what_is_higher_than_all_slices_is_clipped_into_the_last():
    tower = np.array([[0.2, 0.2, 0.0], [0.2, 0.2, 100.0]])
    low, high = columns_of(tower, tower)
    assert high["gap_below"] == 62 * 0.5
    assert low["gap_above"] == 62 * 0.5
    assert high["column_extent"] == 100


def test_features_do_not_depend_on_order_place_or_heading_and_leave_the_input_alone(scene):
    xyz, labels, adjacency, rgb, intensity = scene
    inputs = {"rgb": rgb, "intensity": intensity, "height_above_ground": xyz[:, 2].astype(np.float32)}
    copies = [array.copy() for array in (xyz, labels, rgb, intensity)]
    base = compute_supervoxel_features(xyz, labels, adjacency, **inputs)
    again = compute_supervoxel_features(xyz, labels, adjacency, **inputs)
    assert base.values.tobytes() == again.values.tobytes()
    assert all(
        np.array_equal(a, b, equal_nan=a.dtype.kind == "f")
        for a, b in zip(copies, (xyz, labels, rgb, intensity), strict=True)
    )
    order = np.random.default_rng(1).permutation(len(xyz))
    shuffled = compute_supervoxel_features(
        xyz[order], labels[order], adjacency, **{name: values[order] for name, values in inputs.items()}
    )
    assert np.allclose(shuffled.values, base.values, atol=1e-4, equal_nan=True)
    moved = compute_supervoxel_features(xyz + UTM, labels, adjacency, **inputs)
    assert np.allclose(moved.values, base.values, atol=1e-4, equal_nan=True)
    assert np.allclose(moved.centroids - UTM, base.centroids, atol=1e-8)
    quarter = np.c_[-xyz[:, 1], xyz[:, 0], xyz[:, 2]]
    turned = compute_supervoxel_features(quarter, labels, adjacency, **inputs)
    # The raster of columns lies along the axes, so what depends on it is left out.
    steady = [
        j
        for j, name in enumerate(base.names)
        if name.split("_detrended")[0] not in COLUMN_FEATURES and not name.startswith("footprint")
    ]
    assert np.allclose(turned.values[:, steady], base.values[:, steady], atol=1e-4, equal_nan=True)


def test_one_supervoxel_without_neighbours_and_one_point():
    features = compute_supervoxel_features(np.zeros((1, 3)), [0], csr_array((1, 1), dtype=np.int8))
    assert np.isnan(column(features, "linearity")).all()
    assert column(features, "height_range").tolist() == [0]
    assert column(features, "height_range_detrended").tolist() == [0]


def test_bad_input_is_named(scene):
    xyz, labels, adjacency, rgb, intensity = scene
    n = adjacency.shape[0]

    def compute(xyz=xyz, labels=labels, adjacency=adjacency, **kwargs):
        return compute_supervoxel_features(xyz, labels, adjacency, **kwargs)

    with pytest.raises(DataError, match="at least 1 points, got 0"):
        compute(xyz=np.empty((0, 3)), labels=np.empty(0, np.int32))
    with pytest.raises(DataError, match=r"labels must have shape"):
        compute(labels=labels[:-1])
    with pytest.raises(DataError, match=rf"labels .*got -1..{n - 1}"):
        compute(labels=np.where(np.arange(len(labels)) == 0, -1, labels))
    with pytest.raises(DataError, match=r"labels .*got float64"):
        compute(labels=labels.astype(float))
    with pytest.raises(DataError, match=r"1 of .* supervoxels have no point, the first is 3"):
        compute(labels=np.where(labels == 3, 2, labels))
    with pytest.raises(DataError, match="adjacency must be square"):
        compute(adjacency=adjacency[:, :-1])
    with pytest.raises(DataError, match="joins supervoxel 0 with itself"):
        compute(adjacency=csr_array(adjacency + csr_array(np.eye(n, dtype=np.int8))))
    with pytest.raises(DataError, match="rgb must be uint8, got float64"):
        compute(rgb=rgb / 255)
    with pytest.raises(DataError, match=r"rgb must have shape \(1950, 3\)"):
        compute(rgb=rgb[:, :2])
    with pytest.raises(DataError, match="intensity must have shape"):
        compute(intensity=intensity[:5])
    with pytest.raises(DataError, match="height_above_ground must have shape"):
        compute(height_above_ground=intensity[:5])
    with pytest.raises(DataError, match=r"too large for columns of 0\.5 m"):
        compute(xyz=np.vstack([xyz[:-1], [[1e7, 1e7, 0]]]))
    with pytest.raises(ParameterError, match=r"region .*got 'far'"):
        compute(region="far")
    with pytest.raises(ParameterError, match="column_size must be"):
        compute(column_size=0)
    with pytest.raises(ParameterError, match="relief_radius must be"):
        compute(relief_radius=-1)

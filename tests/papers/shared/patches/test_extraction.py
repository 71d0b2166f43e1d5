"""Patches against leaves counted one by one, and the votes of patches on points."""

import numpy as np
import pytest
from references.patches import leaves, votes

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.papers.shared.patches.extraction import PatchParameters, extract_patches
from mlsroad_pipeline.papers.shared.patches.table import Patches, join_patches
from mlsroad_pipeline.papers.shared.patches.voting import vote_on_points

ORIGIN = np.array([389_300.0, 5_819_700.0, 34.0])


@pytest.fixture(scope="module")
def street():
    """A road with a wall and a bush, coloured, 4,000 points."""
    rng = np.random.default_rng(5)
    road = np.column_stack([rng.uniform(0, 6, 2000), rng.uniform(0, 4, 2000), rng.normal(0, 0.01, 2000)])
    wall = np.column_stack([rng.uniform(0, 6, 1500), rng.normal(4.1, 0.01, 1500), rng.uniform(0, 2, 1500)])
    xyz = np.round(np.concatenate([road, wall, rng.normal([3, 2, 0.7], 0.2, (500, 3))]), 3)
    xyz += 5e-4  # off the leaves' faces, where the last bit would decide
    rgb = rng.integers(0, 256, (len(xyz), 3)).astype(np.uint8)
    return PointCloud(xyz, {"rgb": rgb}, ORIGIN, source="street")


@pytest.fixture(scope="module")
def found(street):
    return extract_patches(street, height=street.xyz[:, 2], scene=3)


def some(n=4, *, colour=True, bins=16, scene=0):
    rgb = np.full((n, 3), 0.5) if colour else None
    return Patches(np.full((n, bins), 1 / bins), rgb, np.zeros(n), np.zeros((n, 3)), np.full(n, scene), np.arange(n))


def test_patches_are_the_leaves_of_the_worlds_octree(street, found):
    patch = found.patch_of_point
    cells, occupied = leaves(street.world_xyz(), 0.2)
    assert patch.max() + 1 == len(occupied)
    assert len({(cell, int(p)) for cell, p in zip(cells, patch, strict=True)}) == len(occupied)


def test_scenes_of_one_survey_agree_on_the_leaves(street, found):
    half = street.xyz[:, 0] > 2.9
    other = extract_patches(street.select(half).moved_to(ORIGIN + [2.0, -3.0, 1.0]), height=street.xyz[half, 2])
    pairs = set(zip(found.patch_of_point[half].tolist(), other.patch_of_point.tolist(), strict=True))
    assert len(pairs) == len(other.patches)


def test_colour_height_and_centroid_are_the_means_of_the_points(street, found):
    patches = found.patches
    for p in range(0, len(patches), 7):
        mine = found.patch_of_point == p
        assert np.allclose(patches.centroid[p], street.xyz[mine].mean(axis=0), atol=1e-6)
        assert np.allclose(patches.rgb[p], street["rgb"][mine].mean(axis=0) / 255, atol=1e-6)
        assert patches.height[p] == pytest.approx(street.xyz[mine, 2].mean(), abs=1e-6)
    assert (patches.scene == 3).all() and (patches.label == -1).all()
    total = patches.fpfh.sum(axis=1)
    assert patches.fpfh.shape[1] == 16 and (np.isclose(total, 1, atol=1e-5) | (total == 0)).all()
    assert (total > 0).mean() > 0.99


def test_edges_join_leaves_that_touch(street, found):
    cells = np.floor(street.world_xyz() / 0.2).astype(np.int64)
    place = np.zeros((len(found.patches), 3), np.int64)
    place[found.patch_of_point] = cells
    steps = np.abs(place[:, None] - place[None]).max(axis=2)
    expected = {(i, j) for i, j in np.argwhere(steps == 1).tolist() if i < j}
    assert {tuple(edge) for edge in found.edges.tolist()} == expected
    assert found.edges.dtype == np.int32 and len(expected) == len(found.edges)


def test_excluded_points_have_no_patch(street):
    keep = np.arange(len(street)) % 5 > 0
    part = extract_patches(street, height=np.where(keep, street.xyz[:, 2], np.nan), keep=keep)
    alone = extract_patches(street.select(keep), height=street.xyz[keep, 2])
    assert (part.patch_of_point[~keep] == -1).all()
    assert np.array_equal(part.patch_of_point[keep], alone.patch_of_point)
    assert np.array_equal(part.patches.fpfh, alone.patches.fpfh)


def test_scene_without_ground_is_measured_from_its_lowest_point(street, caplog):
    found = extract_patches(street.without_columns(["rgb"]), height=np.full(len(street), np.nan))
    assert "street has no ground" in caplog.text
    assert found.patches.rgb is None
    lowest = found.patches.centroid[:, 2] - street.xyz[:, 2].min()
    assert np.allclose(found.patches.height, lowest, atol=1e-5)


def test_one_point_is_one_patch_without_shape():
    found = extract_patches(PointCloud(np.zeros((1, 3))), height=np.zeros(1))
    assert len(found.patches) == 1 and not found.patches.fpfh.any() and found.edges.shape == (0, 2)


def test_bad_input_is_named(street):
    with pytest.raises(DataError, match="street: no points to extract patches from"):
        extract_patches(street, height=np.zeros(len(street)), keep=np.zeros(len(street), bool))
    height = np.zeros(len(street))
    height[3] = np.nan
    with pytest.raises(DataError, match="street: height is NaN for 1 of 4000 points"):
        extract_patches(street, height=height)
    with pytest.raises(ParameterError, match=r"integer multiple of patches.voxel_size, got 0\.2 and 0\.15"):
        PatchParameters(voxel_size=0.15)
    with pytest.raises(ParameterError, match="integer multiple"):
        PatchParameters(voxel_size=0.4)
    with pytest.raises(ParameterError, match=r"n_bins .*got 256"):
        PatchParameters(n_bins=256)
    with pytest.raises(DataError, match=r"height of 2 patches .*got \(3,\)"):
        Patches(np.zeros((2, 4)), None, np.zeros(3), np.zeros((2, 3)), np.zeros(2), np.zeros(2))
    with pytest.raises(DataError, match="fpfh of patch 1 is not finite"):
        Patches(np.array([[0.0], [np.nan]]), None, np.zeros(2), np.zeros((2, 3)), np.zeros(2), np.zeros(2))
    with pytest.raises(DataError, match="histograms of 4 and 16 bins"):
        join_patches([some(), some(bins=4)])
    with pytest.raises(DataError, match="lack height, centroid"):
        Patches.from_arrays({name: np.zeros(2) for name in ("fpfh", "scene", "label")})


def test_joined_patches_have_colour_where_all_have_it():
    both = join_patches([some(), some(scene=1)])
    assert both.rgb is not None and both.scene.tolist() == [0] * 4 + [1] * 4
    assert join_patches([some(), some(colour=False)]).rgb is None
    again = Patches.from_arrays(both.to_arrays())
    assert again.label.tolist() == both.label.tolist() and again.fpfh.dtype == np.float32
    assert both.take(both.label == 2).scene.tolist() == [0, 1]


def test_votes_are_those_counted_point_by_point(rng):
    centroids = rng.random((150, 3)) * [4, 4, 1]
    probabilities = rng.dirichlet(np.ones(5), 150)
    probabilities[:40] = np.eye(5)[rng.integers(0, 5, 40)]  # equal sums for equal votes
    xyz = np.concatenate([rng.random((800, 3)) * [4, 4, 1], [[50.0, 0, 0]]])
    label, confidence = vote_on_points(xyz, centroids, probabilities, radius=0.5)
    expected, share = votes(xyz, centroids, probabilities, 0.5)
    assert label.dtype == np.int16 and np.array_equal(label, expected)
    assert np.allclose(confidence, share, atol=1e-6)
    again = vote_on_points(xyz + ORIGIN, centroids + ORIGIN, probabilities, radius=0.5, n_threads=2)
    assert (again[0] == label).mean() > 0.998


def test_votes_name_bad_input():
    with pytest.raises(DataError, match=r"finite, of shape \(2, c\), got \(3, 4\)"):
        vote_on_points(np.zeros((1, 3)), np.zeros((2, 3)), np.zeros((3, 4)), radius=1)
    with pytest.raises(DataError, match="centroids needs at least 1 points"):
        vote_on_points(np.zeros((1, 3)), np.zeros((0, 3)), np.zeros((0, 4)), radius=1)
    with pytest.raises(ParameterError, match="radius"):
        vote_on_points(np.zeros((1, 3)), np.zeros((2, 3)), np.ones((2, 1)), radius=0)
    assert len(vote_on_points(np.zeros((0, 3)), np.zeros((2, 3)), np.ones((2, 1)), radius=1)[0]) == 0

"""Feature regions and groups against closed forms and written-out equations."""

from dataclasses import replace

import numpy as np
import pytest

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.supervoxels.vccs import segment_supervoxels
from mlsroad_pipeline.papers.shared.detection.regions import INTENSITY, RegionParameters, describe_regions
from mlsroad_pipeline.papers.yu2016.visual_words.groups import build_groups, join_groups

COARSE = RegionParameters(voxel_size=0.1, seed_resolution=0.3, normal_radius=0.15, fpfh_radius=0.3)
FINE = RegionParameters(voxel_size=0.05, seed_resolution=0.1, normal_radius=0.15, fpfh_radius=0.3)


def objects_apart(rng):
    """A pole, a wall and a bush, far from each other."""
    pole = np.column_stack([rng.normal(0, 0.004, 1500), rng.normal(0, 0.004, 1500), rng.uniform(0, 4, 1500)])
    wall = np.column_stack([rng.uniform(5, 8, 4000), np.full(4000, 2.0), rng.uniform(0, 3, 4000)])
    bush = rng.uniform([12, 0, 0], [13, 1, 1], (6000, 3))
    parts = [pole, wall, bush]
    return np.concatenate(parts), np.repeat([0, 1, 2], [len(part) for part in parts]).astype(np.int32)


def test_a_pole_is_linear_a_wall_planar_and_a_bush_neither(rng):
    xyz, objects = objects_apart(rng)
    regions = describe_regions(xyz, objects, parameters=COARSE)
    shape = regions.descriptors[:, :3]
    np.testing.assert_allclose(shape.sum(axis=1), 1.0, atol=1e-5)
    dominant = [np.median(shape[regions.objects == k], axis=0).argmax() for k in range(3)]
    assert dominant == [0, 1, 2]
    assert (np.abs(regions.orientations[regions.objects == 0][:, 2]) > 0.99).all()
    histograms = regions.descriptors[:, 3:INTENSITY]
    np.testing.assert_allclose(histograms[regions.objects == 1].sum(axis=1), 1.0, atol=1e-5)
    assert (regions.descriptors[:, INTENSITY] == 0).all()


def test_region_of_one_object_is_what_its_equations_say(rng):
    xyz = rng.uniform(0, 1, (3000, 3))
    intensity = rng.random(3000)
    regions = describe_regions(xyz, np.zeros(3000, np.int32), intensity=intensity, parameters=COARSE)
    moved = xyz - np.floor(xyz.min(axis=0) / 0.1) * 0.1
    supervoxels = segment_supervoxels(moved, voxel_size=0.1, seed_resolution=0.3, anchor=np.zeros(3))
    assert len(regions) == len(supervoxels)
    for s in range(0, len(regions), 3):
        neighbors = supervoxels.adjacency.indices[supervoxels.adjacency.indptr[s] : supervoxels.adjacency.indptr[s + 1]]
        inside = np.isin(supervoxels.labels, [s, *neighbors])
        points, values = xyz[inside], intensity[inside]
        eigenvalues = np.sqrt(np.linalg.eigvalsh(np.cov(points.T, bias=True))[::-1])
        expected = [eigenvalues[0] - eigenvalues[1], eigenvalues[1] - eigenvalues[2], eigenvalues[2]] / eigenvalues[0]
        np.testing.assert_allclose(regions.descriptors[s, :3], expected, atol=2e-5)
        weight = (values - values.min()) / np.ptp(values)
        assert regions.descriptors[s, INTENSITY] == pytest.approx((weight * values).sum() / weight.sum(), rel=1e-5)
        off = points - regions.centres[s]
        vector = np.linalg.eigh(off.T @ off / len(off))[1][:, -1]
        assert abs(vector @ regions.orientations[s]) > 1 - 1e-4
        reach = np.linalg.norm(supervoxels.centroids[neighbors] - supervoxels.centroids[s], axis=1)
        assert regions.scales[s] == pytest.approx(max(reach.max(initial=0.0), 0.3), rel=1e-5)


def test_descriptions_of_objects_are_independent(rng):
    bush = rng.uniform(0, 1, (4000, 3))
    touching = np.concatenate([bush, bush + [1.0, 0, 0]])
    owner = np.repeat([0, 1], 4000).astype(np.int32)
    together = describe_regions(touching, owner, parameters=COARSE)
    alone = describe_regions(bush, np.zeros(4000, np.int32), parameters=COARSE)
    mine = together.objects == 0
    assert mine.sum() == len(alone)
    np.testing.assert_allclose(together.descriptors[mine], alone.descriptors, atol=1e-5)
    np.testing.assert_allclose(together.centres[mine], alone.centres, atol=1e-9)


def test_equal_intensities_give_their_mean_and_few_points_are_no_error():
    one = describe_regions([[5.0, 5, 5]], [3], intensity=[0.4], parameters=FINE)
    assert len(one) == 1 and one.objects.tolist() == [3]
    np.testing.assert_allclose(one.descriptors[0], [0, 0, 1, *np.zeros(16), 0.4], atol=1e-7)
    assert one.scales[0] == pytest.approx(0.1) and np.linalg.norm(one.orientations[0]) == pytest.approx(1.0)
    assert len(describe_regions(np.zeros((3, 3)), [-1, -1, -1])) == 0


def test_single_pattern_describes_less(rng):
    xyz, objects = objects_apart(rng)
    single = describe_regions(xyz, objects, parameters=replace(COARSE, pattern="single"))
    wide = describe_regions(xyz, objects, parameters=COARSE)
    assert len(single) == len(wide)
    np.testing.assert_array_equal(single.scales, wide.scales)
    assert np.abs(single.descriptors - wide.descriptors).max() > 0.1


@pytest.mark.parametrize("k", [0, 2, 4])
def test_groups_hold_the_nearest_regions_of_the_same_object(rng, k):
    xyz, objects = objects_apart(rng)
    regions = describe_regions(xyz, objects, parameters=COARSE)
    groups = build_groups(regions, k=k)
    assert groups.descriptors.shape == (len(regions), k + 1, 20)
    np.testing.assert_array_equal(groups.descriptors[:, 0], regions.descriptors)
    for g in range(0, len(regions), 17):
        mine = np.flatnonzero(regions.objects == regions.objects[g])
        away = np.linalg.norm(regions.centres[mine] - regions.centres[g], axis=1)
        near = mine[np.argsort(away, kind="stable")[1 : k + 1]]
        assert sorted(groups.scales[g, 1:].tolist()) == sorted(regions.scales[near].tolist())


def test_small_objects_repeat_their_nearest_region():
    xyz = np.array([[0.0, 0, 0], [0.15, 0, 0], [50.0, 0, 0]])
    regions = describe_regions(xyz, np.array([0, 0, 1], np.int32), parameters=FINE)
    groups = build_groups(regions, k=2)
    assert len(regions) == 3
    np.testing.assert_array_equal(groups.scales[2], np.repeat(regions.scales[2], 3))
    np.testing.assert_array_equal(groups.descriptors[0, 1], groups.descriptors[0, 2])


def test_result_does_not_depend_on_threads_or_order_of_points(rng):
    xyz, objects = objects_apart(rng)
    one, two = (describe_regions(xyz, objects, parameters=COARSE, n_threads=n) for n in (1, 2))
    assert one.descriptors.tobytes() == two.descriptors.tobytes()
    order = rng.permutation(len(xyz))
    other = describe_regions(xyz[order], objects[order], parameters=COARSE)
    assert len(other) == len(one)
    np.testing.assert_allclose(np.sort(other.centres[:, 2]), np.sort(one.centres[:, 2]), atol=1e-9)


def test_bad_input(rng):
    with pytest.raises(DataError, match=r"objects .*got float64"):
        describe_regions(np.zeros((2, 3)), [0.0, 1.0])
    with pytest.raises(ParameterError, match=r"pattern .*got 'both'"):
        RegionParameters(pattern="both")
    with pytest.raises(ParameterError, match=r"k .*got 6"):
        build_groups(describe_regions(np.zeros((2, 3)), [0, 0]), k=6)
    with pytest.raises(DataError, match="no contextual groups to join"):
        join_groups([])
    regions = describe_regions(rng.uniform(0, 1, (50, 3)), np.zeros(50, np.int32))
    with pytest.raises(DataError, match="groups of different sizes cannot be joined: 1, 3"):
        join_groups([build_groups(regions, k=0), build_groups(regions, k=2)])

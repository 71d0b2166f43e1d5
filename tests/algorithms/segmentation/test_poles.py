"""Separation of poles from planted crowns and shrubs; trees keep their trunks."""

import numpy as np
import pytest

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.geometry.voxels.grid import build_voxel_grid
from mlsroad_pipeline.algorithms.segmentation.normalized_cut import NormalizedCutParameters, segment
from mlsroad_pipeline.algorithms.segmentation.poles import join_stacked_poles, rejoin_floating_parts, separate_poles

UNCUT = {"max_cut": 0.0}  # then separation is not due to cuts


def pole(rng, x, y, height=7.0, n=5000, lean=0.0):
    """A tube of 0.06 m radius with a lamp on an arm."""
    angle, z = rng.uniform(0, 2 * np.pi, n), rng.uniform(0, height, n)
    tube = np.column_stack([x + 0.06 * np.cos(angle) + lean * z, y + 0.06 * np.sin(angle), z])
    arm = np.column_stack(
        [x + lean * height + rng.uniform(0, 1.2, 400), y + rng.normal(0, 0.02, 400), np.full(400, height)]
    )
    return np.concatenate([tube, arm])


def crown(rng, x, y, z, radius, n=12000):
    """A ball of leaves."""
    direction = rng.normal(size=(n, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    return direction * radius * rng.random((n, 1)) ** (1 / 3) + [x, y, z]


def tree(rng, x, y, height=5.0, radius=2.0, n=12000):
    """A crown on a trunk of 0.12 m radius."""
    angle, z = rng.uniform(0, 2 * np.pi, n // 5), rng.uniform(0, height, n // 5)
    trunk = np.column_stack([x + 0.12 * np.cos(angle), y + 0.12 * np.sin(angle), z])
    return np.concatenate([crown(rng, x, y, height, radius, n), trunk])


def segmented(parts, **changes):
    """Return the IoU of each part with its largest segment, and the number of segments."""
    truth = np.repeat(np.arange(len(parts)), [len(part) for part in parts])
    found = segment(np.concatenate(parts), parameters=NormalizedCutParameters(**{**UNCUT, **changes}))
    overlap = []
    for k in range(len(parts)):
        best = np.bincount(found[truth == k]).argmax()
        overlap.append(((truth == k) & (found == best)).sum() / ((truth == k) | (found == best)).sum())
    return overlap, found.max() + 1


@pytest.mark.parametrize(("aside", "lean"), [(0.8, 0.0), (1.2, 0.03), (1.8, -0.02)])
def test_lamp_in_a_crown_is_an_object_of_its_own(aside, lean, rng):
    parts = [tree(rng, 0, 0), pole(rng, aside, 0, lean=lean)]
    assert segmented(parts, pole_length=0)[1] == 1
    overlap, n_found = segmented(parts)
    assert n_found == 2
    assert min(overlap) > 0.85


def test_lamp_that_rises_from_a_shrub_is_an_object_of_its_own(rng):
    parts = [crown(rng, 0.2, 0, 0.5, 0.8, 4000), pole(rng, 0, 0)]
    assert segmented(parts, pole_length=0)[1] == 1
    overlap, n_found = segmented(parts)
    assert n_found == 2
    assert min(overlap) > 0.85


def test_two_posts_of_one_plate_are_one_sign(rng):
    plate = np.column_stack([rng.uniform(-0.9, 0.9, 4000), rng.normal(0, 0.005, 4000), rng.uniform(2.0, 3.0, 4000)])
    sign = [pole(rng, x, 0, height=3.0)[:5000] for x in (-0.6, 0.6)]
    overlap, n_found = segmented([np.concatenate([*sign, plate])])
    assert n_found == 1
    assert overlap[0] == 1.0


def test_trees_keep_their_trunks_and_lone_lamps_their_arms(rng):
    for parts in ([tree(rng, 0, 0)], [tree(rng, 0, 0), tree(rng, 3.5, 0.5)], [pole(rng, 0, 0)]):
        assert segmented(parts)[1] == 1


@pytest.mark.parametrize(("lower", "upper"), [(-0.04, 0.08), (-0.05, 0.08)])
def test_a_bent_trunk_is_not_taken_out_of_its_palm(lower, upper, rng):
    angle, z = rng.uniform(0, 2 * np.pi, 16000), rng.uniform(0, 14, 16000)
    bent = np.where(z < 7, lower, upper) * (z - 7)
    trunk = np.column_stack([0.12 * np.cos(angle) + bent, 0.12 * np.sin(angle), z])
    withered = crown(rng, 0, 0, 7, 0.7, 3000)  # which breaks the line in two
    palm = np.concatenate([trunk, withered, crown(rng, upper * 7, 0, 14, 1.5)])
    assert segmented([palm])[1] == 1


def test_a_wall_is_no_row_of_poles(rng):
    streaks = [
        np.column_stack([np.full(400, 0.25 * k), rng.normal(0, 0.005, 400), rng.uniform(0, 5, 400)]) for k in range(20)
    ]
    sill = np.column_stack([rng.uniform(0, 5, 3000), rng.normal(0, 0.005, 3000), np.full(3000, 2.5)])
    assert segmented([np.concatenate([*streaks, sill])])[1] == 1


def test_two_trees_joined_by_a_lamp_fall_apart_with_it(rng):
    parts = [tree(rng, 0, 0, radius=1.6), pole(rng, 2.0, 0), tree(rng, 4.0, 0, radius=1.6)]
    overlap, n_found = segmented(parts, tolerance=0.5)
    assert n_found == 3
    assert min(overlap) > 0.8


def test_parts_are_those_of_the_clusters_in_any_order_and_elsewhere(rng):
    places = np.unique(np.round(np.concatenate([tree(rng, 0, 0), pole(rng, 0.9, 0)]), 1), axis=0)
    clusters = np.zeros(len(places), np.int32)
    counts = np.full(len(places), 3)
    found, _ = separate_poles(places, counts, clusters, free_length=1.2)
    assert set(found) == {0, 1}
    order = rng.permutation(len(places))
    np.testing.assert_array_equal(separate_poles(places[order], counts, clusters, free_length=1.2)[0], found[order])
    again, _ = separate_poles(np.concatenate([places, places + [30.0, 0, 0]]), np.tile(counts, 2),
                           np.repeat(np.array([0, 1], np.int32), len(places)), free_length=1.2)  # fmt: skip
    assert len(set(again)) == 4
    np.testing.assert_array_equal(again[: len(places)] != 0, found != 0)


def test_clusters_without_poles_are_unchanged():
    none, _ = separate_poles(np.zeros((0, 3)), np.zeros(0, np.int64), np.zeros(0, np.int32), free_length=1.2)
    assert len(none) == 0
    flat, _ = separate_poles(np.zeros((1, 3)), np.ones(1, np.int64), np.zeros(1, np.int32), free_length=1.2)
    assert flat.tolist() == [0]


def test_negative_length_is_an_error():
    with pytest.raises(ParameterError, match="pole_length"):
        NormalizedCutParameters(pole_length=-1.0)


def test_parts_without_a_foot_join_the_part_they_touch_most():
    def column(x, low, high):
        z = np.arange(low, high, 0.1)
        return np.column_stack([np.full(len(z), x), np.zeros(len(z)), z])

    # A crown's half hangs on the left tree along 30 voxels and on the right one along 10; something else has its own foot.
    pieces = [column(0.0, 0, 6), column(0.1, 3, 6), column(0.2, 0, 4), column(5.0, 4, 6), column(9.0, 0, 1)]
    places = np.concatenate(pieces)
    parts = np.repeat(np.arange(5), [len(piece) for piece in pieces])
    clusters = np.array([0, 0, 0, 1, 0], np.int32)[parts]
    found = rejoin_floating_parts(places, clusters, parts, foot_height=2.0, reach=0.11)
    first = [found[parts == k][0] for k in range(5)]
    assert first[1] == first[0]
    assert len({first[0], first[2], first[3], first[4]}) == 4  # the fourth is a cluster of its own: nothing to go to
    np.testing.assert_array_equal(rejoin_floating_parts(places, clusters, parts, foot_height=4.0, reach=0.11), parts)
    # Two voxels of the trunk do not give the crown's half a foot: it is still taken back.
    crown = np.tile(pieces[1], (20, 1)) + np.repeat(np.arange(20), len(pieces[1]))[:, None] * [0, 0.1, 0]
    many = np.concatenate([pieces[0], crown, [[0.1, 0, 0.1], [0.1, 0, 0.2]]])
    halves = np.repeat([0, 1], [len(pieces[0]), len(crown) + 2])
    one = rejoin_floating_parts(many, np.zeros(len(many), np.int32), halves, foot_height=2.0, reach=0.11)
    assert one.max() == 0
    order = np.random.default_rng(1).permutation(len(parts))
    again = rejoin_floating_parts(places[order], clusters[order], parts[order], foot_height=2.0, reach=0.11)
    np.testing.assert_array_equal(again, found[order])


def test_half_a_crown_that_was_cut_off_is_joined_again(rng):
    long_crown = np.concatenate([crown(rng, x, 0, 5, 1.5, 5000) for x in (0.0, 3.0)])
    stem = np.column_stack([rng.normal(0, 0.05, 2000), rng.normal(0, 0.05, 2000), rng.uniform(0, 4, 2000)])
    points = np.concatenate([long_crown, stem])
    cut = segment(points, parameters=NormalizedCutParameters(tolerance=0.3, pole_length=0, foot_height=0))
    joined = segment(points, parameters=NormalizedCutParameters(tolerance=0.3, pole_length=0))
    assert cut.max() == 1
    assert joined.max() == 0


def test_lamp_beside_a_thick_trunk_is_an_object_though_the_crown_lies_around_it(rng):
    """The trunk is too thick to be a stem; the crown stands on it all the same."""
    angle, z = rng.uniform(0, 2 * np.pi, 9000), rng.uniform(0, 5, 9000)
    trunk = np.column_stack([-0.6 + 0.35 * np.cos(angle), 0.35 * np.sin(angle), z])
    whole = np.concatenate([trunk, crown(rng, -0.3, 0, 5.0, 2.2, 20000)])
    overlap, n_found = segmented([whole, pole(rng, 0.25, 0)])
    assert n_found == 2
    assert min(overlap) > 0.85


def test_segments_of_an_occluded_pole_are_one_object(rng):
    whole = pole(rng, 0, 0)
    seen = whole[(whole[:, 2] < 2.6) | (whole[:, 2] > 3.9)]
    assert segmented([seen], pole_gap=0)[1] == 2
    assert segmented([seen])[1] == 1
    assert segmented([seen], pole_gap=1.0)[1] == 2


def test_other_parts_are_not_joined_with_a_pole(rng):
    post = pole(rng, 0, 0, height=2.0)[:5000]
    beside = post + [0.4, 0, 3.0]
    wide = crown(rng, 0, 0, 4.2, 1.0)
    stump = post[post[:, 2] < 0.8]
    for lower, upper in ((post, beside), (post, wide), (stump, post + [0, 0, 1.6])):
        assert segmented([lower, upper])[1] == 2
    nothing = np.zeros(0, np.int64)
    assert len(join_stacked_poles(np.zeros((0, 3)), nothing, max_gap=2.0)) == 0


def test_a_gantry_keeps_its_legs(rng):
    """Legs are as straight as poles; their beam lies beside them like the crown of another stem."""
    legs = [
        np.column_stack([rng.uniform(x - 0.1, x + 0.1, 4000), rng.uniform(-0.1, 0.1, 4000), rng.uniform(0, 6.5, 4000)])
        for x in (0.0, 9.0)
    ]
    beam = np.column_stack(
        [rng.uniform(-0.5, 9.5, 60000), rng.uniform(-0.35, 0.35, 60000), rng.uniform(5.9, 6.5, 60000)]
    )
    gantry = np.concatenate([*legs, beam])
    found = segment(gantry, parameters=NormalizedCutParameters(max_cut=0.0))
    assert np.bincount(found).max() > 0.99 * len(gantry)


def test_a_lamp_in_the_very_middle_of_a_crown_is_an_object_if_a_leaning_trunk_is_near(rng):
    """Fronds of a palm that grows 0.8 m off lie around the lamp; the trunk, which leans, carries them."""
    angle, z = rng.uniform(0, 2 * np.pi, 4000), rng.uniform(0, 9, 4000)
    trunk = np.column_stack([-0.8 + 0.04 * z + 0.12 * np.cos(angle), 0.12 * np.sin(angle), z])
    palm = np.concatenate([trunk, crown(rng, 0.0, 0, 9.0, 1.6)])
    overlap, n_found = segmented([palm, pole(rng, 0.0, 0, height=10.0)])
    assert n_found == 2
    assert min(overlap) > 0.85


def sign(rng, x, y, height=2.6):
    """A post of 0.03 m radius with a square plate of 0.6 m at its top."""
    angle, z = rng.uniform(0, 2 * np.pi, 2000), rng.uniform(0, height, 2000)
    post = np.column_stack([x + 0.03 * np.cos(angle), y + 0.03 * np.sin(angle), z])
    plate = np.column_stack(
        [rng.uniform(x - 0.3, x + 0.3, 2000), np.full(2000, y - 0.05), rng.uniform(height - 0.6, height, 2000)]
    )
    return np.concatenate([post, plate])


def shell(rng, low, high, n=6000):
    """The surface of a box."""
    unit = rng.random((n, 3))
    unit[np.arange(n), rng.integers(0, 3, n)] = rng.integers(0, 2, n)
    return np.asarray(low) + unit * (np.asarray(high) - np.asarray(low))


def test_a_sign_is_separated_from_the_bin_at_its_foot(rng):
    parts = [sign(rng, 0, 0), shell(rng, (0.09, -0.25, 0.0), (0.6, 0.25, 1.05))]
    assert segmented(parts, pole_length=0)[1] == 1
    overlap, n_found = segmented(parts)
    assert n_found == 2
    assert min(overlap) > 0.85


def test_a_car_keeps_its_aerial(rng):
    aerial = np.column_stack([rng.normal(1.5, 0.005, (400, 2)) * [1, 0], rng.uniform(1.5, 2.1, 400)])
    car = np.concatenate([shell(rng, (0, -0.9, 0.3), (4.4, 0.9, 1.5), 30000), aerial])
    assert segmented([car])[1] == 1


def test_floating_parts_that_touch_each_other_join_a_part_with_a_foot():
    """Two halves of a beam touch each other most, and neither has a foot; one post carries both."""
    post = np.column_stack([np.zeros(40), np.zeros(40), np.arange(40) * 0.1])
    beam = np.array([[x, y, 4.0] for x in np.arange(0, 40) * 0.1 for y in (0.0, 0.1, 0.2)])
    places = np.concatenate([post, beam])
    parts = np.repeat([0, 1, 2], [40, 60, 60])
    joined = rejoin_floating_parts(places, np.zeros(160, np.int32), parts, foot_height=2.0, reach=0.2)
    assert len(np.unique(joined)) == 1


def portal(rng, thickness, n):
    """Two legs 16 m apart, and between them a beam, or wires of 0.02 m."""
    legs = [
        np.column_stack([rng.normal(x, 0.06, 4000), rng.normal(0, 0.06, 4000), rng.uniform(0, 6.5, 4000)])
        for x in (0.0, 16.0)
    ]
    lines = [
        rng.uniform([-1, y - thickness, 6.35 - thickness], [17, y + thickness, 6.35 + thickness], (n, 3))
        for y in (-0.45, 0.02, 0.49)
    ]
    return np.concatenate([*legs, *lines])


def test_legs_of_a_gantry_are_linked_wherever_it_is_cut(rng):
    """Wires between two masts are no beam: the masts are not one object."""
    for cloud, linked in ((portal(rng, 0.2, 90000), True), (portal(rng, 0.01, 6000), False)):
        grid = build_voxel_grid(cloud, voxel_size=0.1)
        counts = np.bincount(grid.voxel_of_point)
        places = np.column_stack([np.bincount(grid.voxel_of_point, cloud[:, k]) / counts for k in range(3)])
        _, links = separate_poles(places, counts, np.zeros(len(places), np.int32), free_length=1.2)
        assert (len(links) == 1) == linked
        if linked:
            assert sorted(places[links[0], 0].round().astype(int).tolist()) == [0, 16]

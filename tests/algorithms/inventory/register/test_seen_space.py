"""Voxels that rays cross against a slow reference, and planted places."""

import numpy as np

from mlsroad_pipeline.algorithms.inventory.register.seen_space import (
    BEHIND,
    CELL,
    FURNITURE,
    HALF,
    LOW,
    LOW_VEGETATION,
    NO_KIND,
    SIDE,
    SLICE,
    SLICES,
    TREE,
    SeenSpace,
    add_rays,
    index_places,
)


def seen_by(places, kind, scanner, points, point_kind):
    seen = SeenSpace.unseen(len(places))
    add_rays(seen, index_places(places), kind, scanner, points, point_kind)
    return seen


def slow_free(place, scanner, points):
    """Return voxels that rays certainly cross, from dense samples well inside the voxels."""
    crossed = np.zeros((SLICES, SIDE, SIDE), bool)
    for start, end in zip(scanner, points, strict=True):
        length = np.linalg.norm(end - start)
        t = np.arange(0, length - BEHIND, 0.002)[:, None] / length
        local = (start + t * (end - start) - place + [HALF, HALF, -LOW]) / [CELL, CELL, SLICE]
        inside = ((local >= 0) & (local < [SIDE, SIDE, SLICES])).all(axis=1)
        cell, times = np.unique(np.floor(local[inside]).astype(int), axis=0, return_counts=True)
        cell = cell[times * 0.002 > 1.1 * CELL / 2]  # the kernel takes steps of half a voxel
        crossed[cell[:, 2], cell[:, 0], cell[:, 1]] = True
    return crossed


def test_free_voxels_are_those_of_a_slow_reference(rng):
    places = np.column_stack([rng.random((3, 2)) * 14 - 7, rng.random(3)])
    scanner = np.column_stack([rng.random((150, 2)) * 8 - 20, np.full(150, 2.5)])
    points = np.column_stack([rng.random((150, 2)) * 24 - 12, rng.random(150) * 4])
    none = np.full(150, NO_KIND, np.uint8)
    seen = seen_by(places, np.zeros(3, np.uint8), scanner, points, none)
    for row, place in enumerate(places):
        certain = slow_free(place, scanner, points)
        assert certain.any() and (seen.free[row][certain] > 0).all()
        widened = np.pad(certain, 1)
        near = np.any(
            [np.roll(widened, (i, j, k), (0, 1, 2)) for i in (-1, 0, 1) for j in (-1, 0, 1) for k in (-1, 0, 1)], axis=0
        )
        assert ((seen.free[row] > 0) & ~near[1:-1, 1:-1, 1:-1]).sum() <= 0.1 * (seen.free[row] > 0).sum()


def test_points_are_counted_in_their_voxel_by_kind():
    place = np.array([[10.0, 5.0, 1.0]])
    point = np.array([[10.05, 5.05, 1.0 + LOW + 0.1]])
    where = (0, 0, SIDE // 2, SIDE // 2)
    cases = [
        (0, 0, 1, 0),
        (0, 1, 0, 1),
        (0, FURNITURE, 0, 1),
        (0, LOW_VEGETATION, 0, 0),
        (TREE, LOW_VEGETATION, 0, 1),
        (0, NO_KIND, 0, 0),
    ]
    for kind, of_point, own, other in cases:
        seen = seen_by(place, np.array([kind], np.uint8), np.zeros((1, 3)), point, np.array([of_point], np.uint8))
        assert (seen.hit[where], seen.own[where], seen.other[where]) == (1, own, other)
        assert seen.hit.sum() == 1


def test_nothing_is_proved_beyond_a_point_nor_just_before_it():
    place, eye = np.array([[10.0, 0.0, 0.0]]), np.array([[0.0, 0.05, 1.0]])
    kinds = np.zeros(1, np.uint8), np.array([NO_KIND], np.uint8)
    for end, proved in ((8.0, False), (9.4, False), (20.0, True)):
        seen = seen_by(place, kinds[0], eye, np.array([[end, 0.05, 1.0]]), kinds[1])
        assert (seen.rays[0] == 1) == proved and (seen.free.sum() > 0) == proved
    seen = seen_by(place, kinds[0], eye, np.array([[20.0, 0.05, 1.0]]), kinds[1])
    assert (seen.free[0, int((1.0 - LOW) / SLICE), :, SIDE // 2] == 1).all() and seen.free.sum() == SIDE


def test_upright_rays_and_rays_without_length_are_counted():
    place = np.array([[0.0, 0.0, 0.0], [0.3, 0.0, 0.0]])
    eyes = np.array([[0.05, 0.05, 9.0], [0.05, 0.05, 1.0]])
    points = np.array([[0.05, 0.05, 0.0], [0.05, 0.05, 1.0]])
    seen = seen_by(place, np.zeros(2, np.uint8), eyes, points, np.full(2, NO_KIND, np.uint8))
    assert (seen.free[0, :, SIDE // 2, SIDE // 2] == 1).all() and seen.rays.tolist() == [1, 1]

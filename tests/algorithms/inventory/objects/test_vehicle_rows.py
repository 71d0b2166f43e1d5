"""Rows of parked vehicles become single vehicles; long vehicles stay whole."""

import numpy as np
import pytest

from mlsroad_pipeline.algorithms.inventory.objects.fragments import join_voxels
from mlsroad_pipeline.algorithms.inventory.objects.measured_rows import split_row
from mlsroad_pipeline.algorithms.inventory.objects.voxel_sums import voxelise

CAR, VAN, LORRY = (4.5, 1.8, 1.5), (5.4, 2.0, 2.3), (10.5, 2.5, 3.4)
TURN = np.radians(20.0)


def shell(size, x, y, rng, n=4000):
    """Return points of the sides and the top of a vehicle; cars have lower ends than their roof."""
    length, width, height = size
    p = rng.uniform([-length / 2, -width / 2, 0.25], [length / 2, width / 2, height], (n, 3))
    roof = height if size is not CAR else np.where(np.abs(p[:, 0]) > 1.4, 0.95, height)
    p[:, 2] = np.minimum(p[:, 2], roof)
    side = rng.integers(0, 3, n)
    p[side == 0, 1] = np.sign(p[side == 0, 1]) * width / 2
    p[side == 1, 0] = np.sign(p[side == 1, 0]) * length / 2
    p[side == 2, 2] = (roof if np.isscalar(roof) else roof[side == 2]) if size is CAR else height
    return p + [x, y, 0.0]


def parts_of(points):
    """Return the part of each voxel and the voxels, turned by 20 degrees."""
    turn = np.array([[np.cos(TURN), np.sin(TURN), 0], [-np.sin(TURN), np.cos(TURN), 0], [0, 0, 1]])
    n, origin = len(points), np.array([391_000.0, 5_820_000.0, 34.0])
    table, _ = voxelise(
        points @ turn, group=np.zeros(n, np.int32), core=np.ones(n, bool), confidence=np.ones(n),
        height_above_ground=None, origin=origin, resolution=0.05,
    )  # fmt: skip
    voxels = join_voxels(table.assign(object=0, scene=0), resolution=0.05)[0]
    return split_row(voxels), (voxels.xyz - origin) @ turn.T


def row(*vehicles, gap, beside=False):
    """Return vehicles one behind the other or side by side, and the middles of the gaps between them."""
    rng, points, gaps, at = np.random.default_rng(5), [], [], 0.0
    for size in vehicles:
        extent = size[1] if beside else size[0]
        middle = at + extent / 2
        points.append(shell(size, *((0.0, middle) if beside else (middle, 0.0)), rng))
        at += extent + gap
        gaps.append(at - gap / 2)
    return np.concatenate(points), np.array(gaps[:-1])


@pytest.mark.parametrize(
    ("vehicles", "beside"),
    [((CAR, CAR), False), ((CAR, CAR, CAR, CAR), False), ((VAN, CAR), False), ((CAR, CAR), True), ((CAR,) * 5, True)],
)
@pytest.mark.parametrize("gap", [0.22, 0.28])
def test_a_row_becomes_its_vehicles(vehicles, beside, gap):
    points, gaps = row(*vehicles, gap=gap, beside=beside)
    part, xyz = parts_of(points)
    assert part.max() + 1 == len(vehicles)
    vehicle = np.searchsorted(gaps, xyz[:, 1 if beside else 0])
    assert len(set(zip(part.tolist(), vehicle.tolist(), strict=True))) == len(vehicles)


@pytest.mark.parametrize("size", [CAR, VAN, LORRY, (5.7, 2.0, 1.9)])
def test_one_vehicle_stays_whole(size):
    assert parts_of(shell(size, 0.0, 0.0, np.random.default_rng(1)))[0].max() == 0


def test_a_car_with_a_shadow_of_a_post_stays_whole():
    points = shell(CAR, 0.0, 0.0, np.random.default_rng(2))
    assert parts_of(points[np.abs(points[:, 0] - 0.3) > 0.14])[0].max() == 0


def test_a_tall_lorry_with_a_gap_behind_its_cab_stays_whole():
    points = shell(LORRY, 0.0, 0.0, np.random.default_rng(3))
    assert parts_of(points[np.abs(points[:, 0] - 3.0) > 0.14])[0].max() == 0


def test_few_points_stay_whole():
    assert parts_of(np.array([[0.0, 0.0, 0.5]]))[0].tolist() == [0]

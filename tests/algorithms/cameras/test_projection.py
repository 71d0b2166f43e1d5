import json

import numpy as np
import pytest
from references.simulator import brown_conrady

from mlsroad_pipeline.algorithms.cameras.camera import Camera
from mlsroad_pipeline.algorithms.cameras.projection import project_points, sample_image
from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.geometry.lenses import fold_radius

LENS = [-0.105, 0.021, 0.0006, -0.0004, -0.0012]
K = np.array([[310.0, 0.4, 243.0], [0, 312.0, 176.0], [0, 0, 1]])


def turned(angles):
    """Return Rz Ry Rx, multiplied out of the elementary rotations."""
    out = np.eye(3)
    for axis, angle in zip(((1, 2), (2, 0), (0, 1)), angles, strict=True):
        step = np.eye(3)
        step[np.ix_(axis, axis)] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
        out = step @ out
    return out


def camera(**changes):
    values = {
        "K": K,
        "distortion": LENS,
        "R": turned([0.2, -0.4, 1.1]),
        "t": [0.5, -1.0, 3.0],
        "width": 480,
        "height": 360,
    }
    return Camera(**{**values, **changes})


def test_pixels_are_those_of_the_printed_equations(rng):
    view = camera()
    xyz = rng.normal(0, 8, (500, 3))
    pixels, depth, inside = project_points(xyz, view)
    extrinsic = np.eye(4)
    extrinsic[:3, :3], extrinsic[:3, 3] = view.R, view.t
    for i in range(len(xyz)):
        x, y, z, _ = extrinsic @ [*xyz[i], 1.0]
        assert depth[i] == pytest.approx(z, abs=1e-12)
        # The reference lens folds back at a radius of about 2.3; places beyond are in no image.
        if z <= 0 or np.hypot(x / z, y / z) > fold_radius(view.distortion):
            assert np.isnan(pixels[i]).all() and not inside[i]
            continue
        u, v, _ = view.K @ [*brown_conrady(x / z, y / z, view.distortion), 1.0]
        assert pixels[i] == pytest.approx([u, v], rel=1e-12)
        assert inside[i] == (-0.5 <= u < 479.5 and -0.5 <= v < 359.5)
    assert 20 < inside.sum() < 300 and (depth <= 0).sum() > 50


def test_the_optical_axis_meets_the_principal_point_and_pixels_end_half_way_to_the_next():
    view = Camera([[2.0, 0, 1], [0, 2.0, 1], [0, 0, 1]], None, np.eye(3), np.zeros(3), 3, 3)
    across = np.array([0.0, -0.75, -0.7501, 0.7499, 0.75])
    pixels, _, inside = project_points(np.column_stack([across, 0 * across, 0 * across + 1]), view)
    assert pixels[:, 0].tolist() == pytest.approx([1, -0.5, -0.5002, 2.4998, 2.5])
    assert inside.tolist() == [True, True, False, True, False]


def test_what_a_lens_folds_back_into_the_image_is_not_in_it():
    view = camera(R=np.eye(3), t=[0, 0, 0], distortion=[-0.3, 0.0, 0, 0, 0])
    radius = fold_radius(view.distortion)
    assert radius == pytest.approx(1 / np.sqrt(0.9))  # 1 - 0.9 r^2 = 0
    place = 1.8  # bends to 1.8 (1 - 0.3 * 3.24) = 0.05, the middle of the image
    pixels, _, inside = project_points([[place, 0, 1.0], [0.05, 0, 1.0]], view)
    assert np.isnan(pixels[0]).all() and inside.tolist() == [False, True]
    assert fold_radius(np.zeros(5)) == np.inf and fold_radius(np.array([0.1, 0, 0, 0, 0.0])) == np.inf


def test_utm_coordinates_keep_a_hundredth_of_a_pixel(rng):
    view, utm = camera(), np.array([500_000.0, 5_800_000.0, 300.0])
    xyz = np.round(rng.normal(0, 8, (200, 3)), 3)
    near, _, seen = project_points(xyz, view)
    far, _, seen_far = project_points(xyz + utm, view.shifted(-utm))
    assert np.array_equal(seen, seen_far) and seen.any()
    np.testing.assert_allclose(far[seen], near[seen], atol=1e-5)
    np.testing.assert_allclose(view.shifted(-utm).centre, view.centre + utm, atol=1e-6)


def test_float32_points_are_multiplied_as_float64(rng):
    xyz = rng.normal(0, 8, (100, 3)).astype(np.float32)
    one, other = project_points(xyz, camera()), project_points(xyz.astype(np.float64), camera())
    assert all(np.array_equal(a, b, equal_nan=True) for a, b in zip(one, other, strict=True))


def test_points_take_the_value_of_their_pixel():
    image = np.arange(12).reshape(3, 4)
    pixels = np.array([[0.4, 0.4], [3.4, 2.4], [np.nan, np.nan], [-0.5, 1.5]])
    rows = np.array([True, True, False, True])
    assert sample_image(image, pixels, rows, fill=-1).tolist() == [0, 11, -1, 8]
    assert sample_image(np.dstack([image, -image]), pixels, rows)[1].tolist() == [11, -11]
    with pytest.raises(DataError, match=r"\[3.0, 2.0\] lies outside an image of 3 x 3"):
        sample_image(image[:, :3], pixels, rows)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"K": np.eye(2)}, r"K must have shape \(3, 3\), got \(2, 2\)"),
        ({"K": None}, "K must"),
        ({"K": np.diag([-1.0, 1, 1])}, "focal lengths > 0, got -1"),
        ({"K": np.array([[1.0, 0, 0], [0, 1, 0], [0, 0, 2]])}, "upper triangular"),
        ({"R": np.diag([1.0, 1, -1])}, "R must be a rotation"),
        ({"R": 1.1 * np.eye(3)}, "R must be a rotation"),
        ({"t": [0, np.nan, 0]}, "t must be finite"),
        ({"distortion": [0.1]}, r"distortion must have shape .* got \(1,\)"),
        ({"width": 0}, "width must be an integer from 1 to 1048576, got 0"),
        ({"height": 2.5}, "height must be an integer from 1 to 1048576, got 2.5"),
    ],
)
def test_a_camera_that_is_none_is_refused(changes, message):
    with pytest.raises(ParameterError, match=message):
        camera(**changes)


def test_another_projection_of_real_scans_is_reproduced_point_by_point(real_data):
    folder = real_data("kitti_painted")
    given = json.loads((folder / "calibration.json").read_text())
    width, height = given["image_size"]
    p2 = np.array(given["P2"])
    extrinsic = np.array(given["rectification"]) @ np.array(given["lidar_to_camera"])
    view = Camera(
        p2[:3, :3], None, extrinsic[:3, :3], extrinsic[:3, 3] + np.linalg.solve(p2[:3, :3], p2[:3, 3]), width, height
    )  # fmt: skip
    shared = different = 0
    for frame in ("000000", "000005", "000010", "000015"):
        scan = np.fromfile(folder / f"{frame}.bin", np.float32).reshape(-1, 4)
        painted = np.fromfile(folder / f"{frame}_painted.bin", np.float32).reshape(-1, 4)[:, 3]
        pixels, depth, _ = project_points(scan[:, :3], view)
        cells = np.trunc(pixels)
        window = (scan[:, 0] >= 0) & (scan[:, 0] <= 50) & (np.abs(scan[:, 1]) <= 25)
        mask = window & (depth > 0) & (cells >= 0).all(axis=1) & (cells < [width, height]).all(axis=1)
        assert np.array_equal(mask, painted != 255)
        place = cells[mask] @ [1, width]
        order = np.lexsort((painted[mask], place))
        same = np.diff(place[order]) == 0
        shared += same.sum()
        different += (np.diff(painted[mask][order])[same] != 0).sum()
    assert shared > 100 and different == 0

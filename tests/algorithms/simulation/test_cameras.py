import numpy as np
from references_simulator import nearest_image_colour

from mlsroad_pipeline.algorithms.simulation.cameras import CAMERAS, calibration, camera_pose
from mlsroad_pipeline.algorithms.simulation.colouring import colour_points, spread_colours
from mlsroad_pipeline.algorithms.simulation.lenses import distort


def project(xyz, image):
    seen = xyz @ image.R.T + image.t
    plane = np.full((len(xyz), 2), 9.0)
    near = np.abs(seen[:, :2]).max(axis=1) < 1.3 * seen[:, 2]
    plane[near] = distort(seen[near, :2] / seen[near, 2:], image.distortion)
    return plane * [image.K[0, 0], image.K[1, 1]] + image.K[:2, 2], seen[:, 2]


def test_poses_look_where_the_cameras_are_mounted(parameters):
    pose = np.array([10.0, 20.0, 5.0, 0.0, 0.0, 0.5])
    for camera, (yaw, pitch, lever, field) in CAMERAS.items():
        rotation, translation = camera_pose(camera, pose)
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(rotation) > 0
        axis = rotation.T @ [0, 0, 1]
        assert np.arctan2(axis[1], axis[0]) == np.float64(0.5 + yaw) or np.isclose(
            np.cos(np.arctan2(axis[1], axis[0]) - 0.5 - yaw), 1
        )
        np.testing.assert_allclose(axis[2], -np.sin(pitch), atol=1e-12)
        down = rotation.T @ [0, 1, 0]
        assert down[2] < -0.9
        assert np.linalg.norm(-rotation.T @ translation - pose[:3]) == np.float64(np.linalg.norm(lever)) or np.isclose(
            np.linalg.norm(-rotation.T @ translation - pose[:3]), np.linalg.norm(lever)
        )
        k = calibration(camera, parameters)
        assert np.isclose(2 * np.arctan(parameters.image_width / 2 / k[0, 0]), field)


def test_projected_points_have_the_label_of_their_pixel(survey, stream, photographs):
    images, depths = photographs
    moving = survey.objects.loc[survey.objects["moving"], "instance"]
    cloud = survey.cloud.select(~np.isin(survey.cloud["instance"], moving))
    right = total = 0
    for image, depth in zip(images, depths, strict=True):
        uv, z = project(cloud.xyz.astype(np.float64), image)
        pixel = np.floor(uv + 0.5)
        inside = (z > 0.3) & (pixel >= 0).all(axis=1) & (pixel < [image.width, image.height]).all(axis=1)
        u, v = pixel[inside].astype(int).T
        visible = np.abs(z[inside] - depth[v, u]) < 0.06 + 0.01 * depth[v, u]
        right += (image.label[v, u] == cloud["label"][inside])[visible].sum()
        total += visible.sum()
    assert total > 3000
    assert right / total > 0.95


def test_images_show_the_street_and_the_sky(survey):
    assert [image.time for image in survey.images] == sorted(image.time for image in survey.images)
    assert {image.camera for image in survey.images} == set(CAMERAS)
    assert len({image.name for image in survey.images}) == len(survey.images)
    for image in survey.images:
        assert image.rgb.shape == (image.height, image.width, 3) and image.rgb.dtype == np.uint8
        assert image.label.shape == (image.height, image.width) and image.label.dtype == np.uint8
        assert (image.label[-1] > 0).all()
        assert image.rgb.std() > 15
    assert sum((image.label == 0).any() for image in survey.images) >= 3


def test_colours_are_those_of_the_nearest_image_that_sees_the_point(survey, photographs, rng):
    images, depths = photographs
    rows = rng.choice(len(survey.cloud), 300, replace=False)
    xyz, times = survey.cloud.xyz[rows].astype(np.float64), survey.cloud["gps_time"][rows]
    rgb, seen = colour_points(xyz, times, images, depths)
    assert 50 < seen.sum() < 300
    for i in range(300):
        expected = nearest_image_colour(xyz[i], times[i], images, depths)
        assert seen[i] == (expected is not None)
        np.testing.assert_array_equal(rgb[i], expected if seen[i] else [0, 0, 0])


def test_no_image_colours_nothing():
    rgb, seen = colour_points(np.zeros((4, 3)), np.zeros(4), [], [])
    assert not seen.any() and not rgb.any()


def test_unseen_points_borrow_from_the_nearer_neighbour_of_their_scanner():
    xyz = np.zeros((6, 3))
    xyz[:, 0] = [0.0, 0.1, 0.15, 0.4, 0.45, 3.0]
    scanner = np.array([0, 0, 1, 0, 0, 0], dtype=np.uint8)
    seen = np.array([True, False, False, False, True, False])
    rgb = np.zeros((6, 3), dtype=np.uint8)
    rgb[0], rgb[4] = 10, 200
    filled = spread_colours(xyz, scanner, rgb, seen, 0.5)
    # The third point is alone in its scanner, the last is too far away.
    assert filled[:, 0].tolist() == [10, 10, 0, 200, 200, 0]
    assert rgb[1, 0] == 0

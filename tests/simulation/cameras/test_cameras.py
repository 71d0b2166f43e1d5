from dataclasses import replace

import numpy as np
from references.simulator import brown_conrady, nearest_image_colour, scene_of

from mlsroad_pipeline.algorithms.geometry.lenses import distort, undistort
from mlsroad_pipeline.simulation.cameras.cameras import (
    CAMERAS,
    DISTORTION,
    calibration,
    camera_pose,
    colour_points,
    spread_colours,
    take_image,
)
from mlsroad_pipeline.simulation.model.meshes import Surface
from mlsroad_pipeline.simulation.model.solids import box
from mlsroad_pipeline.simulation.street.drive import pose_at


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


def test_lenses_bend_as_brown_and_conrady_say_and_back(rng):
    for camera, coefficients in DISTORTION.items():
        plane = rng.uniform(-0.9, 0.9, (300, 2))
        bent = distort(plane, np.array(coefficients))
        np.testing.assert_allclose(bent, [brown_conrady(*p, coefficients) for p in plane], atol=1e-14, err_msg=camera)
        np.testing.assert_allclose(undistort(bent, np.array(coefficients)), plane, atol=1e-10)
        assert np.abs(bent - plane).max() > 0.02


def test_a_pixel_and_its_depth_are_the_point_that_projects_into_it(stream, scene, parameters):
    exact = replace(parameters, image_readout=0.0)
    drive = replace(stream.drive, reported=stream.drive.true)
    image, depth = take_image(scene, drive, stream.light, exact, camera="front_left", time=0.4, name="x")
    v, u = np.nonzero(np.isfinite(depth))
    plane = undistort(np.column_stack([(u - image.K[0, 2]) / image.K[0, 0], (v - image.K[1, 2]) / image.K[1, 1]]),
                      image.distortion)  # fmt: skip
    seen = np.column_stack([plane, np.ones(len(plane))]) * depth[v, u, None]
    uv, z = project((seen - image.t) @ image.R, image)
    np.testing.assert_allclose(uv, np.column_stack([u, v]), atol=2e-3)
    np.testing.assert_allclose(z, depth[v, u], rtol=1e-4)
    # A ray straight to that point meets the label and the instance of the pixel.
    rows = np.arange(0, len(u), 97)
    eye = -image.R.T @ image.t - scene.centre
    towards = ((seen[rows] - image.t) @ image.R) - scene.centre - eye
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    rays = np.hstack([np.tile(eye, (len(rows), 1)), towards]).astype(np.float32)
    hits = scene.cast(rays, np.full(len(rows), 0.4))
    assert (scene.resolve(hits, rays).label == image.label[v, u][rows]).mean() > 0.97
    assert (scene.instances[hits.face] == image.instance[v, u][rows]).mean() > 0.97
    assert len(np.unique(image.instance)) > 4


def test_rows_are_exposed_one_after_the_other(stream, parameters):
    """A thing that stands still seems to lean, as far as the vehicle drives between two rows."""
    drive, time, readout = stream.drive, 0.5, 0.1
    pose = pose_at(drive.true, time)
    forward, left = np.array([np.cos(pose[5]), np.sin(pose[5]), 0]), np.array([-np.sin(pose[5]), np.cos(pose[5]), 0])
    wall = box([0.5, 0.5, 60.0], pose[:3] + 6.0 * forward + 3.0 * left, Surface(77, (0.3, 0.3, 0.3), 0.3))
    scene = scene_of(stream.street, [wall], [7], [], np.round(pose[:3]))
    rolling = replace(parameters, image_readout=readout)
    image, depth = take_image(scene, drive, stream.light, rolling, camera="front_left", time=time, name="x")
    (top, _), (bottom, _) = (np.argwhere(image.instance == 7)[k] for k in (0, -1))
    assert bottom - top > 0.9 * (image.height - 1)
    speed = np.linalg.norm(pose_at(drive.true, time + 0.05)[:3] - pose_at(drive.true, time - 0.05)[:3]) / 0.1
    later = readout * (bottom - top) / (image.height - 1)
    # Depth along the tilted optical axis, turned into distance along the road.
    rows = [top, bottom]
    columns = [int(np.median(np.flatnonzero(image.instance[row] == 7))) for row in rows]
    cells = np.column_stack([columns, rows])
    plane = undistort((cells - image.K[:2, 2]) / [image.K[0, 0], image.K[1, 1]], image.distortion)
    seen = np.column_stack([plane, [1, 1]]) * depth[rows, columns][:, None]
    ahead = (seen @ image.R) @ forward
    assert ahead[0] - ahead[1] == np.float64(speed * later) or abs(ahead[0] - ahead[1] - speed * later) < 0.25


def test_the_shadow_of_a_pole_falls_away_from_the_sun(stream, parameters):
    drive, time = stream.drive, 0.5
    pose = pose_at(drive.true, time)
    forward, left = np.array([np.cos(pose[5]), np.sin(pose[5]), 0]), np.array([-np.sin(pose[5]), np.cos(pose[5]), 0])
    floor = pose[:3] - [0, 0, 2.35]
    foot = floor + 9.0 * forward + 4.0 * left
    grey = Surface(77, (0.3, 0.3, 0.3), 0.3)
    meshes = [box([200, 200, 1.0], floor - [0, 0, 0.5], grey), box([0.4, 0.4, 3.0], foot + [0, 0, 1.5], grey)]
    scene = scene_of(stream.street, meshes, [0, 1], [], np.round(floor))
    towards_sun = (left + [0, 0, 1.0]) / np.sqrt(2)
    light = stream.light._replace(sun=towards_sun, sun_rgb=np.full(3, 1.5), haze=1e-6)
    still = replace(parameters, image_readout=0.0, image_width=480, image_height=360)
    exact = replace(drive, reported=drive.true)
    image, _ = take_image(scene, exact, light, still, camera="front_left", time=time, name="x")

    def brightness(aside):
        # The sun stands at 45 degrees to the left: what is h high throws its shadow h to the right.
        uv, _ = project((foot + aside * left)[None], image)
        u, v = np.round(uv[0]).astype(int)
        return image.rgb[v - 1 : v + 2, u - 1 : u + 2].mean()

    for shadowed in (-1.0, -2.0, -2.7):
        assert brightness(shadowed) < 0.75 * brightness(-shadowed)
    assert brightness(-3.8) > 0.9 * brightness(3.8)

import json

import numpy as np
import pandas as pd
import pytest
from PIL import Image as Picture

from mlsroad_pipeline.algorithms.cameras.poses import rotation_of
from mlsroad_pipeline.algorithms.cameras.projection import project_points
from mlsroad_pipeline.algorithms.core.exceptions import DataError, ReadError
from mlsroad_pipeline.surveys.camera_files import read_images

ORIGIN = np.array([389_300.0, 5_819_700.0, 34.0])
MOUNT = {"x": 0.4, "y": 0.3, "z": 1.9}
TURN = [0.5, -0.5, 0.5, -0.5]  # a camera that looks ahead: its z is the vehicle's x, its x the vehicle's right
POINTS = np.array([[9.0, 1.0, 1.0], [14.0, -3.0, 2.5]])


def calibration(**changes):
    rotation = rotation_of([TURN]).as_matrix()[0].T
    place = np.array(list(MOUNT.values()))
    row = {
        "name": "00001_front", "camera": "front", "gps_time": 100.5, "K": [[300, 0, 99.5], [0, 300, 74.5], [0, 0, 1]],
        "distortion": [-0.1, 0.02, 0, 0, 0], "R": rotation.tolist(), "t": (-rotation @ place).tolist(),
        "width": 200, "height": 150,
    }  # fmt: skip
    return {key: value for key, value in {**row, **changes}.items() if value is not None}


def written(folder, *rows, **more):
    given = {"origin": ORIGIN.tolist(), "images": list(rows), **more}
    (folder / "calibration.json").write_text(json.dumps(given))
    (folder / "images").mkdir(exist_ok=True)
    picture = np.arange(200 * 150 * 3, dtype=np.uint32).reshape(150, 200, 3).astype(np.uint8)
    Picture.fromarray(picture).save(folder / "images" / "00001_front.png")
    return folder / "calibration.json", picture


def poses(folder):
    table = pd.DataFrame({"gps_time": [100.0, 101.0], "x": [389_300.0, 389_310.0], "y": 5_819_700.0, "z": 34.0, "roll": 0.0, "pitch": 0.0, "heading": 0.0})  # fmt: skip
    table.to_csv(folder / "trajectory.csv", index=False)
    return folder / "trajectory.csv"


def pixels(images):
    """Project the points, which are ahead of a vehicle that stands at the origin plus 5 m."""
    (image,) = images.relative_to(ORIGIN)
    found, _, inside = project_points(POINTS + [5.0, 0, 0], image.camera)
    assert inside.all()
    return found


def test_a_picture_is_loaded_on_demand(tmp_path):
    path, picture = written(tmp_path, calibration())
    images = read_images(path)
    (image,) = images
    assert (image.name, image.group, image.time, images.groups) == ("00001_front", "front", 100.5, ("front",))
    assert np.array_equal(image.load(), picture) and np.array_equal(images.origin, ORIGIN)
    (tmp_path / "images" / "00001_front.png").unlink()
    with pytest.raises(ReadError, match=r"00001_front.*no such picture"):
        read_images(path)[0].load()


def test_json_table_and_mounted_cameras_give_one_camera(tmp_path):
    shift = np.array([5.0, 0, 0])
    rotation, mounted = np.array(calibration()["R"]), np.array(calibration()["t"])
    path, _ = written(tmp_path, calibration(t=(mounted - rotation @ shift).tolist()))
    expected = pixels(read_images(path))
    shared = {key: calibration()[key] for key in ("K", "distortion", "R", "t", "width", "height")}
    bare = {"name": "00001_front", "camera": "front", "gps_time": 100.5}
    path, _ = written(tmp_path, bare, cameras={"front": shared})
    np.testing.assert_allclose(pixels(read_images(path, trajectory=poses(tmp_path))), expected, atol=1e-6)
    row = {**bare, "fx": 300, "fy": 300, "cx": 99.5, "cy": 74.5, "width": 200, "height": 150, "k1": -0.1, "k2": 0.02}
    turn = dict(zip(("qw", "qx", "qy", "qz"), TURN, strict=True))
    placed = {"x": 389_305.4, "y": 5_819_700.3, "z": 35.9, **turn}
    pd.DataFrame([{**row, **placed}]).to_csv(tmp_path / "images.csv", index=False)
    images = read_images(tmp_path / "images.csv")
    np.testing.assert_allclose(pixels(images), expected, atol=1e-5)
    assert images[0].load().shape == (150, 200, 3)
    pd.DataFrame([{**row, **{f"mount_{k}": v for k, v in {**MOUNT, **turn}.items()}}]).to_csv(tmp_path / "images.csv")
    np.testing.assert_allclose(
        pixels(read_images(tmp_path / "images.csv", trajectory=poses(tmp_path))), expected, atol=1e-5
    )


@pytest.mark.parametrize(
    ("changes", "error", "message"),
    [
        ({"K": None}, ReadError, "camera 'front' of image '00001_front' has no calibration: no 'K'"),
        ({"R": [[1, 0, 0], [0, 1, 0], [0, 0, -1]]}, ReadError, "image '00001_front': R must be a rotation"),
        ({"R": None}, ReadError, "has no calibration: no 'R'"),
    ],
)
def test_cameras_without_calibration_are_named(tmp_path, changes, error, message):
    path, _ = written(tmp_path, calibration(**changes))
    with pytest.raises(error, match=message):
        read_images(path)


def test_images_without_poses_need_those_of_the_vehicle_at_their_time(tmp_path):
    shared = {key: calibration()[key] for key in ("K", "R", "t", "width", "height")}
    bare = {"name": "00001_front", "camera": "front", "gps_time": 101.5}
    path, _ = written(tmp_path, bare, cameras={"front": shared})
    with pytest.raises(ReadError, match="'00001_front' has no pose, and there is no trajectory"):
        read_images(path)
    with pytest.raises(DataError, match=r"trajectory.csv: 1 of 1 times lie outside .* 100.000 to 101.000 s"):
        read_images(path, trajectory=poses(tmp_path))
    path, _ = written(tmp_path, {**bare, "camera": "rear"}, cameras={"front": shared})
    with pytest.raises(ReadError, match="camera 'rear' of image '00001_front' has no calibration: no 'K'"):
        read_images(path, trajectory=poses(tmp_path))


def test_a_picture_of_another_size_is_named(tmp_path):
    path, _ = written(tmp_path, calibration(width=400))
    with pytest.raises(ReadError, match=r"200 x 150 pixels, the calibration is for 400 x 150"):
        read_images(path)[0].load()
    (tmp_path / "images" / "00001_front.png").write_bytes(b"no picture")
    with pytest.raises(ReadError, match="cannot be read as a picture"):
        read_images(path)[0].load()


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(ReadError, match=r"calibration.json: no such camera calibration"):
        read_images(str(tmp_path / "calibration.json"))


def test_files_of_another_form_are_named(tmp_path):
    path, _ = written(tmp_path, calibration(), calibration())
    with pytest.raises(ReadError, match="'00001_front' occurs more than once"):
        read_images(path)
    path.write_text("[1, 2]")
    with pytest.raises(ReadError, match="no list 'images'"):
        read_images(path)
    path.write_text("{")
    with pytest.raises(ReadError, match="not JSON"):
        read_images(path)
    (tmp_path / "images.csv").write_text("name,camera,gps_time\na,b,1\n")
    with pytest.raises(ReadError, match="no column 'fx'"):
        read_images(tmp_path / "images.csv")
    (tmp_path / "images.xml").write_text("")
    with pytest.raises(ReadError, match="not '.xml'"):
        read_images(tmp_path / "images.xml")


def test_kitti_frames_and_sequences_are_read(tmp_path, real_data):
    folder = real_data("kitti_painted")
    given = json.loads((folder / "calibration.json").read_text())
    values = {name: np.array(given[name])[:3] for name in ("P2", "rectification", "lidar_to_camera")}
    lines = {"P2": values["P2"], "R0_rect": values["rectification"][:, :3], "Tr_velo_to_cam": values["lidar_to_camera"]}
    (tmp_path / "image_2").mkdir()
    for name in ("000000", "000005"):
        (tmp_path / "image_2" / f"{name}.png").write_bytes((folder / f"{name}.png").read_bytes())
    text = {name: " ".join(str(value) for value in matrix.ravel()) for name, matrix in lines.items()}
    (tmp_path / "calib.txt").write_text("".join(f"{name}: {row}\n" for name, row in text.items()))
    frames = read_images(tmp_path)
    scan = np.fromfile(folder / "000000.bin", np.float32).reshape(-1, 4)[:, :3].astype(np.float64)
    ahead = np.column_stack([scan, np.ones(len(scan))])[scan[:, 0] > 5]
    extrinsic = np.array(given["rectification"]) @ np.array(given["lidar_to_camera"])
    homogeneous = ahead @ (values["P2"] @ extrinsic).T
    expected = homogeneous[:, :2] / homogeneous[:, 2:]
    np.testing.assert_allclose(project_points(ahead[:, :3], frames[0].camera)[0], expected, atol=1e-2)
    assert frames[0].load().shape == (370, 1224, 3) and np.isnan(frames[0].time)
    # As a sequence whose second pose is 1 m farther along camera 0's axis.
    tr = " ".join(str(value) for value in extrinsic[:3].ravel())
    (tmp_path / "calib.txt").write_text(f"P2: {text['P2']}\nTr: {tr}\n")
    (tmp_path / "poses.txt").write_text("1 0 0 0 0 1 0 0 0 0 1 0\n1 0 0 0 0 1 0 0 0 0 1 1\n")
    (tmp_path / "times.txt").write_text("0\n0.5\n")
    first, second = read_images(tmp_path / "calib.txt")
    np.testing.assert_allclose(first.camera.centre, frames[0].camera.centre, atol=1e-9)
    step = extrinsic[:3, :3].T @ [0, 0, 1.0]
    np.testing.assert_allclose(second.camera.centre - first.camera.centre, step, atol=1e-6)
    (tmp_path / "times.txt").write_text("0\n")
    with pytest.raises(ReadError, match="1 rows of 1 values for 2 pictures"):
        read_images(tmp_path)
    (tmp_path / "calib.txt").write_text(f"P2: {text['P2']}\n")
    with pytest.raises(ReadError, match=r"calib.txt: Tr_velo_to_cam is missing \(found: P2\)"):
        read_images(tmp_path)


@pytest.mark.parametrize(
    ("key", "name"), [("model", "fisheye"), ("camera_model", "EQUIRECTANGULAR"), ("model", "Kannala-Brandt")]
)
def test_other_projections_are_refused_by_name(tmp_path, key, name):
    path, _ = written(tmp_path, calibration(**{key: name}))
    with pytest.raises(ReadError, match=f"image '00001_front': {key} '{name}' is not supported: .* k1, k2, p1, p2, k3"):
        read_images(path)


@pytest.mark.parametrize("name", ["pinhole", "Brown-Conrady", "OPENCV", "plumb_bob", ""])
def test_names_of_the_perspective_projection_are_read(tmp_path, name):
    path, _ = written(tmp_path, calibration(model=name))
    assert len(read_images(path)) == 1

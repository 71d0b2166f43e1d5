"""Images of `label`: discovery, checks and selection."""

import json
import shutil

import numpy as np
import pytest
from PIL import Image as Picture

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ReadError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.models.labelling import member, with_members
from mlsroad_pipeline.algorithms.scenes.binning import BinnedCloud
from mlsroad_pipeline.algorithms.scenes.corridor import MainAxis
from mlsroad_pipeline.algorithms.scenes.joining import SceneSpan
from mlsroad_pipeline.label import images
from mlsroad_pipeline.label.images import images_of_survey, images_to_label, views_of_scene
from mlsroad_pipeline.surveys.files import SurveyFile
from mlsroad_pipeline.surveys.plan import PlannedFile, SurveyPlan

CLASSES = ["road", "tree"]
CAMERAS = ["front", "back"]
AXES = [[0.0, -1, 0], [0, 0, -1], [1, 0, 0]]


def bundle(slug, **metadata):
    given = {"classes": CLASSES, "cameras": CAMERAS, **metadata}
    return ModelBundle(slug, {"weights": np.arange(3.0), "a.b": np.ones(2)}, given)


@pytest.fixture
def network():
    return bundle("image_labels", parameters={"reach": 25.0})


@pytest.fixture
def fusion(network):
    forest = bundle("detrended_forest", attributes=["rgb"], parameters={"ground": {"x": 1}, "forest": {}})
    parts = {"detrended_forest": forest, "image_labels": network}
    return with_members(bundle("fusion", parameters={"share": 0.5}, attributes=[]), parts)


@pytest.fixture
def survey(tmp_path):
    """Two drives of one file each; images at x = 0, 10, ..., 90 beside the points of the first."""
    camera = {"K": [[9.0, 0, 9.5], [0, 9.0, 7.5], [0, 0, 1]], "distortion": [0] * 5, "width": 20, "height": 16}
    (tmp_path / "north" / "images").mkdir(parents=True)
    (tmp_path / "south").mkdir()
    rows = []
    for k in range(10):
        t = (-np.array(AXES) @ [10.0 * k, 0, 2]).tolist()
        rows.append({"name": f"i{k}", "camera": CAMERAS[k % 2], "gps_time": float(k), "R": AXES, "t": t, **camera})
        Picture.new("RGB", (20, 16)).save(tmp_path / "north" / "images" / f"i{k}.png")
    (tmp_path / "north" / "calibration.json").write_text(json.dumps({"origin": [500.0, 0, 0], "images": rows}))
    return tmp_path


def plan_of(folder, *drives, trajectory=None):
    files = [
        PlannedFile(
            f"survey.{d}", "survey", 0, f"survey.{d}", SurveyFile(str(folder / d / "a.laz"), d, d, trajectory), None
        )
        for d in drives
    ]
    return SurveyPlan(tuple(files), None, False)


def test_members_come_back_as_they_were_and_the_first_prepares_the_scenes(fusion, network):
    assert fusion.metadata["attributes"] == ["rgb"]
    assert fusion.metadata["parameters"] == {"share": 0.5, "ground": {"x": 1}}
    again = member(fusion, "image_labels")
    assert again.metadata == network.metadata and set(again.arrays) == {"weights", "a.b"}
    assert np.array_equal(again.arrays["weights"], network.arrays["weights"])
    assert member(network, "image_labels") is network and fusion.arrays["weights"] is not again.arrays["weights"]
    with pytest.raises(Exception, match="model 'image_labels' has no member 'fusion'; train it again"):
        member(network, "fusion")
    with pytest.raises(DataError, match=r"'fusion' has classes \('road', 'tree'\), its member 'image_labels' \('a',\)"):
        with_members(bundle("fusion"), {"image_labels": bundle("image_labels", classes=["a"])})


def test_images_lie_beside_the_points_of_their_drive(survey, fusion, network, caplog):
    found = images_to_label(plan_of(survey, "north", "south"), fusion, "calibration.json")
    assert list(found.passes) == ["survey.north"] and found.cameras == ("back", "front") and found.reach == 25.0
    assert len(found.passes["survey.north"]) == 10
    assert "beside the points of south: its points have the labels of the features alone" in caplog.text
    everywhere = images_to_label(plan_of(survey, "south"), network, str(survey / "north" / "calibration.json"))
    assert list(everywhere.passes) == ["survey.south"]
    forest = bundle("detrended_forest")
    assert images_to_label(plan_of(survey, "north"), forest, "calibration.json").passes == {}


def test_a_survey_without_images_is_an_error_for_images_alone_and_a_warning_for_the_fusion(
    survey, fusion, network, caplog
):
    with pytest.raises(ReadError, match=r"'image_labels' needs images: there is no .*south/calibration\.json"):
        images_to_label(plan_of(survey, "south"), network, "calibration.json")
    with pytest.raises(ReadError, match="needs images"):
        images_to_label(plan_of(survey, "north"), network, None)
    assert images_to_label(plan_of(survey, "south"), fusion, "calibration.json").passes == {}
    assert "No images (calibration.json) beside the points of south: " in caplog.text


def test_pictures_and_cameras_that_do_not_fit_are_named_before_any_work(survey, fusion, network):
    plan = plan_of(survey, "north")
    path = survey / "north" / "images" / "i3.png"
    shutil.copy(path, survey / "kept.png")
    path.unlink()
    with pytest.raises(ReadError, match=r"i3(\.png)?: no such picture \(image 'i3'\)"):
        images_to_label(plan, network, "calibration.json")
    Picture.new("RGB", (21, 16)).save(path)
    with pytest.raises(ReadError, match=r"i3\.png: the picture has 21 x 16 pixels, the calibration is for 20 x 16"):
        images_to_label(plan, fusion, "calibration.json")
    path.write_bytes(b"no picture")
    with pytest.raises(ReadError, match=r"i3\.png: cannot be read as a picture"):
        images_to_label(plan, fusion, "calibration.json")
    shutil.copy(survey / "kept.png", path)
    calibration = survey / "north" / "calibration.json"
    told = json.loads(calibration.read_text())
    told["images"][4]["camera"] = "side"
    calibration.write_text(json.dumps(told))
    assert images_to_label(plan, network, "calibration.json").cameras == ("back", "front", "side")
    with pytest.raises(DataError, match=r"has a camera 'side'; model 'fusion' was trained with .* front, back"):
        images_to_label(plan, fusion, "calibration.json")
    del told["images"][4]["K"]
    calibration.write_text(json.dumps(told))
    with pytest.raises(ReadError, match=r"calibration\.json: camera 'side' of image 'i4' has no calibration: no 'K'"):
        images_to_label(plan, network, "calibration.json")


def test_cameras_on_the_vehicle_take_its_poses_where_they_cover_the_images(survey, network):
    calibration, track = (survey / "north" / name for name in ("calibration.json", "trajectory.csv"))
    fixed = images_to_label(plan_of(survey, "north"), network, "calibration.json").passes["survey.north"]
    told = json.loads(calibration.read_text())
    mounted = {key: told["images"][0][key] for key in ("K", "distortion", "width", "height", "R")}
    told["cameras"] = {key: {**mounted, "t": (-np.array(AXES) @ [0.0, 0, 2]).tolist()} for key in CAMERAS}
    told["images"] = [{key: row[key] for key in ("name", "camera", "gps_time")} for row in told["images"]]
    calibration.write_text(json.dumps(told))
    with pytest.raises(ReadError, match="image 'i0' has no pose, and there is no trajectory with poses"):
        images_to_label(plan_of(survey, "north"), network, "calibration.json")
    rows = "".join(f"{k},{500 + 10 * k},0,0,0,0,0\n" for k in range(10))
    track.write_text("gps_time,x,y,z,roll,pitch,heading\n" + rows)
    plan = plan_of(survey, "north", trajectory=str(track))
    carried = images_to_label(plan, network, "calibration.json").passes["survey.north"]
    for one, other in zip(fixed, carried, strict=True):
        np.testing.assert_allclose(one.camera.centre, other.camera.centre, atol=1e-9)
    track.write_text("gps_time,x,y,z,roll,pitch,heading\n" + "".join(rows.splitlines(keepends=True)[:8]))
    with pytest.raises(DataError, match=r"trajectory\.csv: 2 of 10 times lie outside .* 0.000 to 7.000 s; .* 8.000 s"):
        images_to_label(plan, network, "calibration.json")


def test_images_within_reach_of_a_scene_are_chosen(survey, network):
    images = images_to_label(plan_of(survey, "north"), network, "calibration.json").passes["survey.north"]
    axis = MainAxis(np.array([540.0, 0.0]), np.array([1.0, 0.0]))  # station 0 is x = 540, the images stand from 500
    span = SceneSpan("s", 5, 10, 3, 12, 1, 1)  # stations 10 to 20 in bins of 2 m
    near = views_of_scene(span, images, axis, bin_length=2.0, reach=15.0)
    assert [view.name for view in near] == ["i4", "i5", "i6", "i7"]
    assert len(views_of_scene(span, images, None, bin_length=2.0, reach=15.0)) == 10


def test_points_around_are_those_before_and_behind_the_buffers(monkeypatch):
    xyz = np.column_stack([np.arange(40.0), np.zeros(40), np.zeros(40)])
    cloud = PointCloud(xyz, {}, np.array([7.0, 0, 0]))
    piece = BinnedCloud(cloud, np.arange(40, dtype=np.int32), np.arange(41, dtype=np.int64)).to_arrays()
    span = SceneSpan("s", 15, 20, 13, 22, 5, 9)
    found = images.points_around([piece], span, 6, np.array([5.0, 0, 0]))
    assert found.dtype == np.float32 and (found[:, 0] - 2).tolist() == [9, 10, 11, 12, 22, 23, 24, 25]
    monkeypatch.setattr(images, "MAX_OCCLUDERS", 4)
    assert (images.points_around([piece], span, 6, cloud.origin)[:, 0]).tolist() == [9, 11, 22, 24]
    assert images.points_around([piece], span, 0, cloud.origin).shape == (0, 3)


def test_objects_without_photos_are_reported_with_the_folder_of_their_points(survey, caplog):
    assert images_of_survey(plan_of(survey / "south", "."), "calibration.json") == {}
    assert f"No images (calibration.json) beside the points of {survey / 'south'}: no photos of objects" in caplog.text

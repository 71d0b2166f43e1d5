"""Labels through images that were segmented elsewhere: masks in files and networks, from a survey to its labels."""

import json
import shutil

import laspy
import numpy as np
import onnx
import pandas as pd
import pytest
from helpers.wiring import TINY, copied_run, empty_store, joined, label, run, session_of
from onnx import TensorProto, helper, numpy_helper
from PIL import Image as Picture

from mlsroad_pipeline.algorithms.cameras.projection import project_points
from mlsroad_pipeline.algorithms.core.classes import TAXONOMY
from mlsroad_pipeline.model_store.registration import load_registered_bundle
from mlsroad_pipeline.papers.tomic2019.image_labels.segmentation import network_of, segment_image
from mlsroad_pipeline.surveys.camera_files import read_images

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]

LONG = {"ingest": {"scene_length": 15.0}}
TRAIN_ID = {
    "road": 0, "lane_marking": 0, "parking": 0, "other_ground": 0, "manhole": 0, "sidewalk": 1, "curb": 1, "building": 2,
    "wall": 3, "fence": 4, "light_pole": 5, "utility_pole": 5, "post": 5, "traffic_light": 6, "traffic_sign": 7,
    "station_sign": 7, "tree": 8, "trunk": 8, "grass": 9, "person": 11, "rider": 12, "car": 13, "van": 13, "truck": 14,
    "bus": 15, "train": 16, "motorcycle": 17, "bicycle": 18,
}  # fmt: skip
CODES_OF = {0: 11, 1: 11, 2: 6, 3: 68, 4: 68, 5: 64, 6: 64, 7: 65, 8: 5, 9: 2, 11: 70, 13: 66}
"""LAS codes of `road_inventory` by train id, for the classes that the tests count."""


@pytest.fixture(scope="module")
def project(shared, tmp_path_factory):
    """A project with a registered network, and masks of the 19 classes beside the pictures of its surveys."""
    folder = copied_run(shared, tmp_path_factory.mktemp("own"))
    table = np.full(256, 255, dtype=np.uint8)
    table[0] = 10  # the sky
    for name, number in TRAIN_ID.items():
        table[TAXONOMY[name]] = number
    for labels in (folder / "data/01_raw/simulated").glob("*/labels"):
        (labels.parent / "train_ids").mkdir()
        for path in labels.glob("*.png"):
            Picture.fromarray(table[np.asarray(Picture.open(path))]).save(labels.parent / "train_ids" / path.name)
    return folder


@pytest.fixture(scope="module")
def survey(project):
    return project / "data/01_raw/simulated/test"


def through_images(project, survey, out, **own):
    """Label a survey with `image_labels` and parameters of it."""
    parameters = {"label": {"survey": str(survey), "output": str(out), "method": "image_labels", "least_score": 0}}
    run(project, "label", **joined(TINY, LONG, parameters, {"image_labels": own}))
    return np.asarray(laspy.read(next(out.glob("*.laz"))).classification)


def test_masks_give_the_labels_of_the_network_that_made_them_byte_for_byte(project, survey, tmp_path):
    label(project, survey, tmp_path / "network", method="image_labels", **LONG)
    with session_of(project, **TINY) as session:
        session.load_context()
        bundle = load_registered_bundle("mlsroad-image_labels")
    network, factor = network_of(bundle), bundle.metadata["parameters"]["magnification"]
    (tmp_path / "masks").mkdir()
    for image in read_images(survey / "calibration.json"):
        scores = segment_image(network, image.load(), magnification=factor)
        np.savez(tmp_path / "masks" / f"{image.name}.npz", probabilities=scores)
    through_images(project, survey, tmp_path / "masked", masks=str(tmp_path / "masks"), classes="scheme")
    one, other = (tmp_path / name / "survey.laz" for name in ("network", "masked"))
    assert one.read_bytes() == other.read_bytes() and len(np.unique(laspy.read(one).classification)) > 2


def test_nineteen_classes_label_a_survey_end_to_end(project, survey, tmp_path, caplog):
    codes = through_images(project, survey, tmp_path / "out", masks="train_ids")
    assert "Labelling with image_labels (masks of train_ids)" in caplog.text and "Nothing to do" not in caplog.text
    (record,) = (tmp_path / "out" / ".mlsroad").glob("*/run.json")
    segmentation = json.loads(record.read_text())["summary"]["segmentation"]
    assert segmentation == {"name": "masks of train_ids", "classes": "cityscapes"}
    assert "masks of train_ids, classes of cityscapes" in (tmp_path / "out" / "report.html").read_text()
    assert (through_images(project, survey, tmp_path / "out", masks="train_ids") == codes).all()
    assert "Nothing to do" in caplog.text
    for other, told in (
        ({"masks": "others"}, "masks"),
        ({"masks": "train_ids", "classes": "scheme"}, "classes"),
        ({}, ""),
    ):
        with pytest.raises(Exception, match=rf"is a result of another run: image_labels(\.{told})? is "):
            through_images(project, survey, tmp_path / "out", **other)
    truth = np.asarray(laspy.read(survey / "survey.laz")["label"])
    counted = np.isin(truth, [TAXONOMY[name] for name, number in TRAIN_ID.items() if number in CODES_OF]) & (codes != 1)
    wanted = np.zeros(256, dtype=int)
    for name, number in TRAIN_ID.items():
        wanted[TAXONOMY[name]] = CODES_OF.get(number, 0)
    assert counted.mean() > 0.3 and (codes[counted] == wanted[truth[counted]]).mean() > 0.9  # the masks are the truth
    assert {11, 6, 5, 66} <= set(codes.tolist())


def test_the_fusion_learns_from_masks_and_labels_with_them(project, survey, tmp_path):
    own = tmp_path / "project"
    shutil.copytree(project, own, ignore=shutil.ignore_patterns("mlflow.db", "mlartifacts", "mlruns"))
    (own / "mlflow.db").write_bytes(empty_store())
    masked = joined(TINY, {"image_labels": {"masks": "train_ids"}})
    with session_of(own, **masked) as session:
        parts = ["detrended_forest", "image_labels", "fusion"]
        ends = ["labelling.image_labels.score_image_labels", "labelling.fusion.learn_fusion"]  # no pictures
        session.run(pipeline_names=parts, to_nodes=ends)
    scores = pd.read_csv(own / "data/08_reporting/scores/image_labels.csv")
    seen = scores[(scores["split"] == "test_visible") & (scores["metric"] == "overall_accuracy")]["value"].item()
    assert seen > 0.85  # a network of thirty steps has 0.3
    out = tmp_path / "out"
    with pytest.raises(Exception, match="model 'fusion' labels through masks"):
        label(own, survey, out, method="fusion", **LONG)
    parameters = {"label": {"survey": str(survey), "output": str(out), "method": "fusion", "least_score": 0}}
    run(own, "label", **joined(masked, LONG, parameters))
    assert len(laspy.read(out / "survey.laz").points) == len(laspy.read(survey / "survey.laz").points)


def test_masks_and_weights_that_do_not_fit_are_named(project, survey, tmp_path):
    shutil.copytree(survey / "train_ids", tmp_path / "masks")
    first = sorted((tmp_path / "masks").iterdir())[0]
    first.unlink()
    for changes, told in (
        ({"masks": str(tmp_path / "masks")}, rf"masks: no mask of image '{first.stem}'"),
        ({"masks": "train_ids", "weights": "x.onnx"}, "are both given"),
        ({"weights": str(tmp_path / "none.pth")}, r"none\.pth: no such weights"),
        ({"weights": network_file(tmp_path, 3)}, r"net\.onnx: has 3 classes, cityscapes names 19 from 0"),
    ):
        with pytest.raises(Exception, match=told):
            through_images(project, survey, tmp_path / "out", **changes)
    with pytest.raises(Exception, match=r"image_labels\.masks is set: use label\.method=image_labels or fusion"):
        run(project, "label", **joined(TINY, {
            "label": {"survey": str(survey), "output": str(tmp_path / "out"), "method": "detrended_forest"},
            "image_labels": {"masks": "train_ids"},
        }))  # fmt: skip


def network_file(folder, n_classes):
    """Write a network that calls every pixel the class 0."""
    kernel, bias = np.zeros((n_classes, 3, 1, 1), np.float32), np.array([9.0, *[0] * (n_classes - 1)], np.float32)
    graph = helper.make_graph(
        [helper.make_node("Conv", ["image", "kernel", "bias"], ["scores"])], "g",
        [helper.make_tensor_value_info("image", TensorProto.FLOAT, [1, 3, "h", "w"])],
        [helper.make_tensor_value_info("scores", TensorProto.FLOAT, None)],
        [numpy_helper.from_array(kernel, "kernel"), numpy_helper.from_array(bias, "bias")],
    )  # fmt: skip
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9), folder / "net.onnx")
    return str(folder / "net.onnx")


def test_a_network_in_onnx_labels_a_survey(project, survey, tmp_path):
    codes = through_images(project, survey, tmp_path / "out", weights=network_file(tmp_path, 19))
    assert set(codes.tolist()) == {1, 11} and (codes == 11).mean() > 0.2  # road in every image


def test_a_frame_of_kitti_is_labelled_by_nineteen_classes(project, real_data, tmp_path):
    drive = real_data("real", "semantickitti_00_images", "sequences", "00")
    raw = (
        np.fromfile(real_data("real", "semantickitti_more", "makeonebug", "label") / "000000.label", np.uint32) & 0xFFFF
    )
    (tmp_path / "drive" / "image_2").mkdir(parents=True)
    for name in ("calib.txt", "image_2/000000.png", "velodyne/000000.bin"):
        shutil.copy(drive / name, tmp_path / "drive" / ("image_2/" if name.endswith("png") else ""))
    xyz = np.fromfile(drive / "velodyne/000000.bin", np.float32).reshape(-1, 4)[:, :3].astype(float)
    train_id = np.full(65536, 255)
    for raw_code, number in {10: 13, 40: 0, 44: 0, 48: 1, 50: 2, 51: 4, 70: 8, 71: 8, 72: 9, 80: 5, 81: 7}.items():
        train_id[raw_code] = number
    (image,) = read_images(tmp_path / "drive" / "calib.txt")
    pixels, depth, inside = project_points(xyz, image.camera)
    mask = np.full((image.camera.height, image.camera.width), 255, dtype=np.uint8)
    rows = np.flatnonzero(inside)[np.argsort(-depth[inside])]  # near points are painted last
    column, line = np.floor(pixels[rows] + 0.5).astype(int).T
    for dy in range(-2, 3):
        for dx in range(-1, 2):
            part = (np.clip(line + dy, 0, mask.shape[0] - 1), np.clip(column + dx, 0, mask.shape[1] - 1))
            mask[part] = train_id[raw[rows]]
    (tmp_path / "drive" / "masks").mkdir()
    Picture.fromarray(mask).save(tmp_path / "drive" / "masks" / "000000.png")
    parameters = {"label": {"images": "calib.txt", "trajectory": None}}
    survey = tmp_path / "drive" / "000000.bin"
    out = tmp_path / "out"
    parameters["label"] |= {"survey": str(survey), "output": str(out), "method": "image_labels"}
    run(project, "label", **joined(TINY, parameters, {"image_labels": {"masks": "masks"}}))
    codes = np.asarray(laspy.read(out / "000000.laz").classification)
    wanted = np.array([CODES_OF.get(int(number), 0) for number in train_id[raw]])
    counted = (codes != 1) & (wanted > 0)
    assert counted.sum() > 10_000 and (codes[counted] == wanted[counted]).mean() > 0.9
    assert {11, 6, 5, 66} <= set(codes.tolist())

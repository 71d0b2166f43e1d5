"""Image-based labeller on planted scenes, with a stub of the network."""

from dataclasses import replace

import numpy as np
import pytest

from mlsroad_pipeline.algorithms.cameras.camera import Camera
from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.models.labelling import label_cloud
from mlsroad_pipeline.algorithms.models.machines import torch_training
from mlsroad_pipeline.model_store.bundle_files import load_bundle, save_bundle
from mlsroad_pipeline.papers.tomic2019.image_labels import labeller, segmentation
from mlsroad_pipeline.papers.tomic2019.image_labels.segmentation import segment_image
from mlsroad_pipeline.papers.tomic2019.image_labels.training_parameters import ImageLabelsParameters

SCHEME = ClassScheme("two", ("a", "b"), (("road",), ("building",)), (), (11, 6))
AXES = np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]])
K = [[100.0, 0, 49.5], [0, 100.0, 39.5], [0, 0, 1]]
QUICK = ImageLabelsParameters(network={"n_steps": 1, "batch_size": 2, "crop": 33})


def picture():
    """Red left, blue right; the rows above are the sky, black."""
    image = np.zeros((80, 100, 3), dtype=np.uint8)
    image[20:, :50, 0] = image[20:, 50:, 2] = 255
    return image


def wall(x, y, step=0.04):
    across, up = np.meshgrid(np.arange(*y, step), np.arange(-1.5, 1.0, step))
    return np.column_stack([np.full(across.size, x), across.ravel(), up.ravel()])


def cloud(xyz, origin=(0.0, 0.0, 0.0), **columns):
    return PointCloud(xyz, {"core": np.ones(len(xyz), dtype=np.bool_), **columns}, np.array(origin))


@pytest.fixture(scope="module")
def model():
    labels = np.zeros((80, 100), dtype=np.int16)
    bundle, losses = labeller.fit(
        [(picture(), labels)] * 2, parameters=QUICK, scheme=SCHEME, cameras=["left", "right"], trained_on={"s": "x"}
    )
    assert len(losses) == 1 and bundle.metadata["trained_on"] == {"s": "x", "images": 2}
    return bundle


def test_the_device_holds_for_training_too(monkeypatch):
    monkeypatch.setattr(torch_training, "_cuda_failure", lambda: "")
    with pytest.raises(ParameterError, match="device is 'cuda', but PyTorch finds no GPU"):
        labeller.fit(
            [(picture(), np.zeros((80, 100), dtype=np.int16))], parameters=replace(QUICK, device="cuda"), scheme=SCHEME,
            cameras=["left"], trained_on={},
        )  # fmt: skip


@pytest.fixture
def by_colour(monkeypatch):
    """Let the network be right: red is class a, blue class b, black the sky."""

    def segment(network, image, *, magnification, window, overlap, flip):
        assert (magnification, window, flip) == ((1.4, 1.8), None, False) and overlap == pytest.approx(1 / 3)
        sky = (image.max(axis=2) == 0)[:, :, None]
        return np.concatenate([image[:, :, :1] > 0, image[:, :, 2:] > 0, sky], axis=2).astype(np.float32)

    monkeypatch.setattr(segmentation, "segment_image", segment)


def views(group="left", place=(0.0, 0.0, 0.0)):
    return [(group, Camera(K, None, AXES, -AXES @ np.array(place), 100, 80), picture)]


def test_points_take_the_class_of_their_pixel_in_their_own_order(model, by_colour, rng):
    xyz = wall(8.0, (-2, 2))[rng.permutation(len(wall(8.0, (-2, 2))))]
    found = labeller.label_scene(cloud(xyz), [], views(), model)
    inside = np.abs(xyz[:, 1]) > 0.1
    assert found["seen"].all() and np.array_equal(found["n_images"], [[1, 0]] * len(xyz))
    assert np.array_equal(found["label"][inside], (xyz[:, 1] < 0).astype(int)[inside])  # y points to the left
    assert (found["confidence"][inside] == 1).all()
    assert np.isnan(found["probabilities"][:, 1]).all() and not np.isnan(found["probabilities"][:, 0]).any()


def test_scenes_beside_hide_points_with_their_cores_alone(model, by_colour):
    scene, front = cloud(wall(8.0, (-2, 2))), wall(4.0, (-1.0, 0.02))
    assert labeller.label_scene(scene, [], views(), model)["seen"].all()
    moved = cloud(front - [100.0, 0, 0], origin=(100.0, 0.0, 0.0))  # the same place, relative to another origin
    hidden = labeller.label_scene(scene, [moved], views(), model)
    shadow = (scene.xyz[:, 1] < -0.1) & (scene.xyz[:, 1] > -1.9)
    assert not hidden["seen"][shadow].any() and hidden["seen"][scene.xyz[:, 1] > 0.2].all()
    assert (hidden["label"][~hidden["seen"]] == -1).all() and (hidden["confidence"][~hidden["seen"]] == 0).all()
    buffer = moved.with_columns(core=np.zeros(len(front), dtype=np.bool_))
    assert labeller.label_scene(scene, [buffer], views(), model)["seen"].all()


def test_outliers_get_no_label_and_hide_nothing(model, by_colour):
    xyz = np.concatenate([wall(8.0, (-2, 2)), wall(4.0, (-1, 1))])
    stray = xyz[:, 0] < 5
    found = labeller.label_scene(cloud(xyz, outlier=stray), [], views(), model)
    assert np.array_equal(found["seen"], ~stray) and (found["label"][stray] == -1).all()


def test_scene_without_images_has_no_labels(model):
    found = labeller.label_scene(cloud(wall(8.0, (-1, 1))), [], [], model)
    assert (found["label"] == -1).all() and not found["seen"].any() and (found["n_images"] == 0).all()


def test_camera_that_the_survey_does_not_have_is_named(model, by_colour):
    with pytest.raises(DataError, match=r"'back'.*\['left', 'right'\]"):
        labeller.label_scene(cloud(wall(8.0, (-1, 1))), [], views("back"), model)


def test_model_outlives_its_files(model, tmp_path):
    save_bundle(model, tmp_path / "model")
    again = load_bundle(tmp_path / "model")
    one, other = (segment_image(segmentation.network_of(bundle), picture()) for bundle in (model, again))
    assert np.array_equal(one, other) and one.shape == (80, 100, 3)


def test_points_alone_and_wrong_parameters_are_refused(model):
    with pytest.raises(ParameterError, match="'image_labels' needs images"):
        label_cloud(model, cloud(wall(8.0, (-1, 1))))
    with pytest.raises(ParameterError, match=r"reach.*-1"):
        ImageLabelsParameters(reach=-1)
    with pytest.raises(ParameterError, match=r"calibration .*got ''"):
        ImageLabelsParameters(calibration="")


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"mean": 5}, "mean must be three numbers for red, green and blue, got 5"),
        ({"mean": ["a", 1, 2]}, r"mean must be three numbers .* got \['a', 1, 2\]"),
        ({"spread": [1, 2, 0]}, "spread must be three numbers above 0"),
        ({"overlap": "a"}, r"overlap must be in \[0, 1\), got 'a'"),
        ({"flip": "no"}, "flip must be true or false, got 'no'"),
        ({"masks": 7}, "masks must be a name, got 7"),
        ({"weights": ["a"]}, r"weights must be a name, got \['a'\]"),
        ({"classes": None}, "classes must be a name, got None"),
        ({"window": [True, 5]}, "window must be height and width"),
    ],
)
def test_values_of_other_types_are_named(given, told):
    with pytest.raises(ParameterError, match=told):
        ImageLabelsParameters(**given)

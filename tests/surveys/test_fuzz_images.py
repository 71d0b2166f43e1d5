"""Damaged masks, class maps, networks and pictures: values, or one line that names the file.

``MLSROAD_FUZZ=1000`` sets the number of mutated files per kind; the suite runs a sample of them.
"""

import os

import numpy as np
import onnx
import pytest
import torch
import yaml
from conftest import REPOSITORY
from helpers.mutations import mutated, mutated_table, mutated_value, refusals
from onnx import TensorProto, helper, numpy_helper
from PIL import Image

from mlsroad_pipeline.algorithms.cameras.camera import Camera
from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.core.exceptions import DataError, ReadError
from mlsroad_pipeline.papers.tomic2019.image_labels.onnx_network import OnnxNetwork
from mlsroad_pipeline.papers.tomic2019.image_labels.pspnet_weights import load_published
from mlsroad_pipeline.surveys.camera_files import read_images
from mlsroad_pipeline.surveys.class_map_files import read_class_map
from mlsroad_pipeline.surveys.masks import MaskLegend, read_mask

N_CASES = int(os.environ.get("MLSROAD_FUZZ", "30"))

CAMERA = Camera([[5.0, 0, 2], [0, 5.0, 1.5], [0, 0, 1]], None, np.eye(3), np.zeros(3), 5, 4)
NUMBERS = np.array([[0, 13, 5, 255, 10]] * 4, dtype=np.uint8)
MAP = "number,name,class\n0,road,road\n5,pole,post\n8,vegetation,tree\n10,sky,\n255,void,\n"
CALIB = "".join(f"P{i}: 700 0 300 0 0 700 100 0 0 0 1 0\n" for i in range(4)) + "Tr: 0 -1 0 0 0 0 -1 0 1 0 0 0\n"
WEIGHTS = {"cls.4.weight": torch.zeros(3, 4, 1, 1), "cls.4.bias": torch.zeros(3), "layer0.0.weight": torch.zeros(4)}
SCHEMES = yaml.safe_load((REPOSITORY / "conf/base/parameters_classes.yml").read_text())["classes"]["schemes"]
SCHEME = ClassScheme.from_config("tomic2019", SCHEMES["tomic2019"])


def palette(path):
    picture = Image.fromarray(NUMBERS)
    picture.putpalette([k % 256 for k in range(768)])
    picture.save(path)


def grey(path):
    Image.fromarray(NUMBERS.astype(np.uint16)).save(path)


def probabilities(path):
    np.savez_compressed(path, probabilities=np.full((4, 5, 19), 1 / 19, dtype=np.float32))


def network(path):
    kernel = (4 * np.eye(3, dtype=np.float32)).reshape(3, 3, 1, 1)
    graph = helper.make_graph(
        [helper.make_node("Conv", ["image", "kernel"], ["scores"])],
        "g",
        [helper.make_tensor_value_info("image", TensorProto.FLOAT, [1, 3, "rows", "columns"])],
        [helper.make_tensor_value_info("scores", TensorProto.FLOAT, None)],
        [numpy_helper.from_array(kernel, "kernel")],
    )
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9), path)


def kitti(path):
    Image.new("RGB", (640, 480)).save(path)
    (path.parents[1] / "calib.txt").write_text(CALIB)


def mutated_yaml(data, rng):
    if rng.random() < 0.5:
        return mutated(data, rng)
    return yaml.safe_dump(mutated_value(yaml.safe_load(data), rng)).encode()


def read_labels(path):
    return read_mask(path, CAMERA, MaskLegend(read_class_map("cityscapes", SCHEME), SCHEME))


def read_map(path):
    return read_class_map(str(path), SCHEME)


def read_network(path):
    return OnnxNetwork(path.read_bytes(), n_numbers=3, device="cpu", source=str(path))


KINDS = {  # file, content or function that writes it, damage, reader
    "palette": ("a.png", palette, mutated, read_labels),
    "grey": ("a.png", grey, mutated, read_labels),
    "probabilities": ("a.npz", probabilities, mutated, read_labels),
    "map": ("m.csv", lambda path: path.write_text(MAP), mutated_table, read_map),
    "yaml": ("m.yml", lambda path: path.write_text("0: road\n5: {name: a, class: post}\n9:\n"), mutated_yaml, read_map),
    "onnx": ("n.onnx", network, mutated, read_network),
    "kitti": ("image_2/0.png", kitti, mutated, lambda path: read_images(path.parents[1])),
}


@pytest.mark.parametrize("kind", KINDS)
def test_damaged_files_of_images(tmp_path, kind):
    name, write, damage, reader = KINDS[kind]
    path = tmp_path / name
    path.parent.mkdir(exist_ok=True)
    write(path)
    assert refusals(path, damage, reader, N_CASES) > N_CASES // 20


def test_damaged_weights_are_refused_without_advice_to_run_code(tmp_path):
    path = tmp_path / "w.pth"
    torch.save(WEIGHTS, path)
    sound = path.read_bytes()
    for case in range(N_CASES):
        path.write_bytes(mutated(sound, np.random.default_rng(case)))
        with pytest.raises(DataError) as caught:  # even sound ones have no layers
            load_published(path)
        text = str(caught.value)
        assert str(path) in text and text.isprintable() and "weights_only" not in text and len(text) < 600


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({3: torch.zeros(2)}, "holds no state dict"),
        ({"cls.4.bias": None}, "holds no state dict"),
        ({"cls.4.bias": torch.tensor([0.0, torch.nan, 0.0])}, r"weights cls\.4\.bias hold NaN, infinity or no real"),
        ({"cls.4.bias": torch.zeros(3, dtype=torch.complex64)}, r"weights cls\.4\.bias hold NaN"),
        ({"layer3.0.\x1b[31m\n": torch.zeros(2)}, r"layer3 has 1 blocks"),
    ],
)
def test_weights_that_no_network_has_are_named(tmp_path, changed, message):
    path = tmp_path / "w.pth"
    torch.save({"state_dict": {**WEIGHTS, **changed}}, path)
    with pytest.raises(DataError, match=rf"w\.pth: .*{message}"):
        load_published(path)


@pytest.mark.parametrize("shape", [(), (3,), (0, 4, 1, 1)])
def test_classes_are_counted_in_weights_of_four_axes(tmp_path, shape):
    path = tmp_path / "w.pth"
    torch.save({**WEIGHTS, "cls.4.weight": torch.zeros(shape)}, path)
    with pytest.raises(DataError, match=r"w\.pth: weights cls\.4\.weight have the shape \("):
        load_published(path, backbone="resnet50")


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_networks_that_return_no_numbers_are_refused(tmp_path, value):
    path = tmp_path / "n.onnx"
    network(path)
    model = onnx.load(path)
    model.graph.initializer[0].CopyFrom(numpy_helper.from_array(np.full((3, 3, 1, 1), value, np.float32), "kernel"))
    with pytest.raises(DataError, match="n: returns NaN or infinity for an image"):
        OnnxNetwork(model.SerializeToString(), n_numbers=3, device="cpu", source="n")


def test_a_picture_with_more_pixels_than_can_be_read_is_one_line(tmp_path, monkeypatch):
    grey(tmp_path / "a.png")
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 5)
    with pytest.raises(ReadError, match=r"a\.png: cannot be read as a picture: Image size \(20 pixels\) exceeds"):
        read_labels(tmp_path / "a.png")

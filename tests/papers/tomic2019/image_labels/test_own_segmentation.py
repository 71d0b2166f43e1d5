"""Models of masks and of networks trained elsewhere."""

from dataclasses import asdict, replace

import numpy as np
import onnx
import pytest
import torch
from onnx import TensorProto, helper, numpy_helper

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError, ReadError
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.models.labelling import member, with_members
from mlsroad_pipeline.label.model_choice import ModelRequest, choose_model, image_request
from mlsroad_pipeline.label.summary import segmentation_source
from mlsroad_pipeline.model_store.bundle_files import load_bundle, save_bundle
from mlsroad_pipeline.papers.tomic2019.image_labels import onnx_network, segmentation
from mlsroad_pipeline.papers.tomic2019.image_labels.own_segmentation import own_model, with_own_segmentation
from mlsroad_pipeline.papers.tomic2019.image_labels.pspnet import PSPNet
from mlsroad_pipeline.papers.tomic2019.image_labels.segmentation import network_of, segmenter_of
from mlsroad_pipeline.papers.tomic2019.image_labels.training_parameters import ImageLabelsParameters

SCHEME = ClassScheme("two", ("ground", "thing"), (("road", "sidewalk"), ("car", "tree")), (), (2, 6))
MAP = "number,class\n0,road\n1,car\n2,\n"


@pytest.fixture
def classes(tmp_path):
    (tmp_path / "map.csv").write_text(MAP)
    return str(tmp_path / "map.csv")


def network_file(folder, n_classes=3):
    """Write a network that scores red, green and blue."""
    kernel = (9 * np.eye(n_classes, 3, dtype=np.float32)).reshape(n_classes, 3, 1, 1)
    graph = helper.make_graph(
        [helper.make_node("Conv", ["image", "kernel"], ["scores"])], "g",
        [helper.make_tensor_value_info("image", TensorProto.FLOAT, [1, 3, "h", "w"])],
        [helper.make_tensor_value_info("scores", TensorProto.FLOAT, None)],
        [numpy_helper.from_array(kernel, "kernel")],
    )  # fmt: skip
    path = folder / "net.onnx"
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9), path)
    return str(path)


def test_a_network_in_onnx_is_stored_with_its_classes(tmp_path, classes):
    made = own_model(ImageLabelsParameters(weights=network_file(tmp_path), classes=classes), SCHEME)
    save_bundle(made, tmp_path / "model")
    (tmp_path / "net.onnx").unlink()
    image = np.zeros((32, 64, 3), np.uint8)
    image[:, :32, 0], image[:, 32:, 1] = 255, 255
    found = segmenter_of(load_bundle(tmp_path / "model"))(image)
    assert (found.argmax(axis=2)[:, :30] == 0).all() and (found.argmax(axis=2)[:, 34:] == 1).all()
    assert made.metadata["segmentation"]["classes"]["rows"][1] == [1, "car", "car"]


def test_the_home_folder_of_weights_is_expanded(tmp_path, classes, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    network_file(tmp_path)
    assert own_model(ImageLabelsParameters(weights="~/net.onnx", classes=classes), SCHEME).slug == "image_labels"


def test_the_network_of_a_process_is_built_once(tmp_path, classes, monkeypatch):
    path, built = network_file(tmp_path), []
    one, other = (
        own_model(ImageLabelsParameters(weights=path, classes=classes, flip=f), SCHEME) for f in (True, False)
    )
    third = own_model(ImageLabelsParameters(weights=path, classes=classes, mean=(1, 2, 3)), SCHEME)
    true = onnx_network.OnnxNetwork
    monkeypatch.setattr(segmentation, "_kept", {})
    monkeypatch.setattr(onnx_network, "OnnxNetwork", lambda *given, **more: built.append(1) or true(*given, **more))
    for model, count in ((one, 1), (other, 1), (third, 2), (one, 3)):
        segmenter_of(model)
        assert len(built) == count


def test_published_weights_are_stored_with_their_classes(tmp_path, classes):
    torch.manual_seed(1)
    network = PSPNet(3, backbone="resnet50")
    torch.save({f"module.{name}": value for name, value in network.state_dict().items()}, tmp_path / "w.pth")
    made = own_model(ImageLabelsParameters(weights=str(tmp_path / "w.pth"), classes=classes), SCHEME)
    own = network_of(made)
    assert (own.backbone, own.n_classes) == ("resnet50", 3) and torch.equal(own.cls[0].weight, network.cls[0].weight)
    assert made.metadata["parameters"]["magnification"] == (1.0,)


def test_what_does_not_fit_is_named(tmp_path, classes):
    with pytest.raises(DataError, match=r"net\.onnx: has 2 classes, .*map\.csv names 3 from 0"):
        own_model(ImageLabelsParameters(weights=network_file(tmp_path, 2), classes=classes), SCHEME)
    with pytest.raises(ReadError, match="no such weights"):
        own_model(ImageLabelsParameters(weights="none.pth", classes=classes), SCHEME)
    with pytest.raises(DataError, match="no network of its own: its images are segmented by masks"):
        network_of(own_model(ImageLabelsParameters(masks="m", classes=classes), SCHEME))


def test_the_segmentation_of_a_fusion_is_replaced(classes):
    given = {"classes": list(SCHEME.classes)}
    given |= {"scheme": asdict(SCHEME), "cameras": ["front"], "parameters": {"reach": 3.0}, "attributes": []}
    members = {name: ModelBundle(name, {"a": np.ones(2)}, given) for name in ("detrended_forest", "image_labels")}
    fusion = with_members(ModelBundle("fusion", {"bias": np.zeros(2)}, given), members)
    changed = with_own_segmentation(fusion, ImageLabelsParameters(masks="m", classes=classes, reach=20.0))
    network = member(changed, "image_labels")
    assert network.metadata["segmentation"]["source"] == "masks" and network.metadata["cameras"] == ["front"]
    assert network.metadata["parameters"]["reach"] == 20.0 and not network.arrays
    assert list(member(changed, "detrended_forest").arrays) == ["a"] and "bias" in changed.arrays
    assert segmentation_source(changed) == {"name": "masks of m", "classes": classes}
    assert segmentation_source(members["detrended_forest"]) is None
    assert segmentation_source(fusion) == {"name": "trained network", "classes": "scheme 'two'"}
    with pytest.raises(ParameterError, match="has no member 'image_labels'"):
        with_own_segmentation(members["detrended_forest"], ImageLabelsParameters(masks="m", classes=classes))


def test_the_device_of_the_run_takes_the_place_of_the_stored_one(tmp_path, classes):
    made = own_model(ImageLabelsParameters(weights=network_file(tmp_path), classes=classes), SCHEME, cameras=["front"])
    parameters = {**made.metadata["parameters"], "device": "cuda", "reach": 12.0}
    trained = replace(made, metadata={**made.metadata, "parameters": parameters})
    forest = ModelBundle("detrended_forest", {}, {**made.metadata, "parameters": {}})
    fusion = with_members(
        ModelBundle("fusion", {}, made.metadata), {"detrended_forest": forest, "image_labels": trained}
    )
    for stored in (trained, fusion):
        save_bundle(stored, tmp_path / stored.slug)
        request = ModelRequest(stored.slug, choose_model(model=str(tmp_path / stored.slug)))
        bundle, _ = image_request(request, ImageLabelsParameters(device="cpu"), {}).bundle()
        network = member(bundle, "image_labels")
        assert network.metadata["parameters"]["device"] == "cpu" and network.metadata["parameters"]["reach"] == 12.0
        assert segmenter_of(network)(np.zeros((32, 32, 3), np.uint8)).shape == (32, 32, 2)


def test_masks_do_not_go_with_a_named_model_of_images(tmp_path, classes):
    save_bundle(own_model(ImageLabelsParameters(masks="m", classes=classes), SCHEME), tmp_path / "model")
    named = choose_model(model=str(tmp_path / "model"))
    for method in (None, "image_labels"):
        with pytest.raises(ParameterError, match=r"masks takes the place of .*model .*: set label\.model to null"):
            image_request(ModelRequest(method, named), ImageLabelsParameters(masks="m", classes=classes), {})


def test_own_segmentation_needs_a_method_that_uses_images(classes, caplog):
    masked, schemes = ImageLabelsParameters(masks="m", classes=classes, scheme="two"), {"two": {
        "classes": {n: {"members": list(m), "asprs": 2} for n, m in zip(SCHEME.classes, SCHEME.members, strict=True)}
    }}  # fmt: skip
    plain = ModelRequest("boosted_trees")
    assert image_request(plain, ImageLabelsParameters(), schemes) == plain
    assert image_request(ModelRequest("image_labels"), masked, schemes).own.slug == "image_labels"
    assert image_request(ModelRequest("fusion"), masked, schemes).images is masked and "another" in caplog.text
    with pytest.raises(ParameterError, match=r"image_labels\.masks is set: use label\.method=image_labels or fusion"):
        image_request(plain, masked, schemes)

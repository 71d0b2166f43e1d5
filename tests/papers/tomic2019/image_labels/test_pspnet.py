from dataclasses import replace

import numpy as np
import pytest
import torch

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError, ReadError
from mlsroad_pipeline.papers.tomic2019.image_labels.pspnet import MEAN, SPREAD, PSPNet, network_input
from mlsroad_pipeline.papers.tomic2019.image_labels.pspnet_training import overlap_loss, train_network
from mlsroad_pipeline.papers.tomic2019.image_labels.pspnet_weights import (
    from_arrays,
    load_published,
    load_state,
    recognise_weights,
    to_arrays,
)
from mlsroad_pipeline.papers.tomic2019.image_labels.segmentation import segment_image
from mlsroad_pipeline.papers.tomic2019.image_labels.training_parameters import TrainingParameters

QUICK = TrainingParameters(n_steps=35, batch_size=4, crop=49, warm_up=3, learning_rate=0.02, class_balance=0.5)


def published_shapes(blocks, n_classes):
    """Names and shapes of published PSPNet weights on a bottleneck ResNet with a deep stem, written out."""
    shapes = {}

    def convolution(name, outputs, inputs, size, bias=False):
        shapes[f"{name}.weight"] = (outputs, inputs, size, size)
        if bias:
            shapes[f"{name}.bias"] = (outputs,)

    def normalisation(name, width):
        for part in ("weight", "bias", "running_mean", "running_var"):
            shapes[f"{name}.{part}"] = (width,)
        shapes[f"{name}.num_batches_tracked"] = ()

    for k, (inputs, outputs) in enumerate([(3, 64), (64, 64), (64, 128)]):
        convolution(f"layer0.{3 * k}", outputs, inputs, 3)
        normalisation(f"layer0.{3 * k + 1}", outputs)
    width = 128
    for stage, (planes, count) in enumerate(zip((64, 128, 256, 512), blocks, strict=True), start=1):
        for b in range(count):
            name = f"layer{stage}.{b}"
            for k, (outputs, inputs, size) in enumerate(
                [(planes, width, 1), (planes, planes, 3), (4 * planes, planes, 1)], 1
            ):
                convolution(f"{name}.conv{k}", outputs, inputs, size)
                normalisation(f"{name}.bn{k}", outputs)
            if b == 0:
                convolution(f"{name}.downsample.0", 4 * planes, width, 1)
                normalisation(f"{name}.downsample.1", 4 * planes)
            width = 4 * planes
    for k in range(4):
        convolution(f"ppm.features.{k}.1", 512, 2048, 1)
        normalisation(f"ppm.features.{k}.2", 512)
    for name, inputs, middle in (("cls", 4096, 512), ("aux", 1024, 256)):
        convolution(f"{name}.0", middle, inputs, 3)
        normalisation(f"{name}.1", middle)
        convolution(f"{name}.4", n_classes, middle, 1, bias=True)
    return shapes


@pytest.mark.parametrize(("backbone", "blocks"), [("resnet50", (3, 4, 6, 3)), ("resnet101", (3, 4, 23, 3))])
def test_weights_are_named_and_shaped_as_published_ones(backbone, blocks):
    with torch.device("meta"):  # shapes without memory
        network = PSPNet(19, backbone=backbone)
    assert {name: tuple(value.shape) for name, value in network.state_dict().items()} == published_shapes(blocks, 19)


def test_dilated_stages_keep_an_eighth_of_the_size():
    with torch.device("meta"):
        network = PSPNet(19, backbone="resnet50").eval()
        x = torch.zeros(1, 3, 65, 97)
        third = network.layer3(network.layer2(network.layer1(network.layer0(x))))
        assert third.shape == (1, 1024, 9, 13) and network.layer4(third).shape == (1, 2048, 9, 13)
    convolutions = [network.layer3[0].conv2, network.layer3[5].conv2, network.layer4[0].conv2]
    assert [(c.dilation, c.stride) for c in convolutions] == [((2, 2), (1, 1))] * 2 + [((4, 4), (1, 1))]


def test_pooled_levels_are_means_over_their_regions():
    network = PSPNet(3).eval()
    level = network.ppm.features[2]
    x = torch.arange(36.0).reshape(1, 1, 6, 6)
    expected = x.reshape(3, 2, 3, 2).mean(dim=(1, 3))
    assert torch.equal(level[0](x)[0, 0], expected)
    features = torch.rand(1, 192, 12, 9)
    out = network.ppm(features)
    assert out.shape == (1, 384, 12, 9) and torch.equal(out[:, :192], features)
    whole = out[0, 192 : 192 + 48]  # one cell: the same everywhere
    assert torch.allclose(whole, whole[:, :1, :1].expand_as(whole))


@pytest.mark.parametrize("size", [(64, 96), (65, 97), (33, 70)])
def test_small_network_sharpens_at_the_size_of_the_image(size):
    network = PSPNet(3).eval()
    with torch.inference_mode():
        main, auxiliary = network(torch.rand(1, 3, *size))
        level = network.layer3(network.layer2(network.layer1(network.layer0(torch.zeros(1, 3, 64, 96)))))
        coarse = network.train()(torch.rand(2, 3, *size))[0]
    assert main.shape == (1, 3, *size) and auxiliary.shape[1] == 3
    assert level.shape[2:] == (2, 3)  # a 32nd, not dilated
    assert coarse.shape[2:] == tuple(2 * -(-side // 4) for side in size)
    assert network.layer4[0].conv2.dilation == (1, 1) and network.layer4[0].conv1.stride == (2, 2)


def test_a_published_file_is_read_with_or_without_its_auxiliary_head(tmp_path):
    network = PSPNet(4)
    state = {f"module.{name}": torch.rand(value.shape) for name, value in network.state_dict().items()}
    bare = {name: value for name, value in state.items() if ".aux." not in name}
    for k, given in enumerate(({"state_dict": state, "epoch": 200}, bare)):
        torch.save(given, tmp_path / f"{k}.pth")
        loaded = load_published(tmp_path / f"{k}.pth", n_classes=4, backbone="small")
        assert torch.equal(loaded.cls[0].weight, state["module.cls.0.weight"]) and not loaded.training


LAYOUTS = {
    "mmseg": [
        ("layer0.", "backbone.stem."), ("layer", "backbone.layer"), ("cls.0.", "decode_head.bottleneck.conv."),
        ("cls.1.", "decode_head.bottleneck.bn."), ("cls.4.", "decode_head.conv_seg."),
        ("aux.0.", "auxiliary_head.convs.0.conv."), ("aux.1.", "auxiliary_head.convs.0.bn."),
        ("aux.4.", "auxiliary_head.conv_seg."),
        *[(f"ppm.features.{k}.1.", f"decode_head.psp_modules.{k}.1.conv.") for k in range(4)],
        *[(f"ppm.features.{k}.2.", f"decode_head.psp_modules.{k}.1.bn.") for k in range(4)],
    ],
    "csail": [
        *[(f"layer0.{3 * k}.", f"encoder.conv{k + 1}.") for k in range(3)],
        *[(f"layer0.{3 * k + 1}.", f"encoder.bn{k + 1}.") for k in range(3)],
        ("layer", "encoder.layer"), ("cls.", "decoder.conv_last."), ("aux.4.", "decoder.conv_last_deepsup."),
        ("aux.", "decoder.cbr_deepsup."), *[(f"ppm.features.{k}.", f"decoder.ppm.{k}.") for k in range(4)],
    ],
}  # fmt: skip


@pytest.mark.parametrize("layout", LAYOUTS)
def test_weights_of_other_projects_are_recognised_by_their_names(layout):
    with torch.device("meta"):
        network = PSPNet(19, backbone=f"resnet50_{layout}")

    def published(name):
        old, new = next(pair for pair in LAYOUTS[layout] if name.startswith(pair[0]))
        return f"module.{new}{name.removeprefix(old)}"

    backbone, weights = recognise_weights({published(n): v for n, v in network.state_dict().items()}, source="w.pth")
    assert backbone == f"resnet50_{layout}" and set(weights) == set(network.state_dict())
    blocks = [network.layer3[0], network.layer3[1], network.layer4[0], network.layer4[1]]
    assert [block.conv2.dilation[0] for block in blocks] == [1, 2, 2, 4]  # halved in the first block of a stage
    assert network.layer0[6].out_channels == (64 if layout == "mmseg" else 128)
    with pytest.raises(DataError, match=r"w\.pth: no PSPNet of semseg, .* such as encoder\.x"):
        recognise_weights({"encoder.x": 1}, source="w.pth")


def test_a_published_file_tells_its_backbone_and_classes(tmp_path):
    with torch.device("meta"):
        shapes = PSPNet(19, backbone="resnet50").state_dict()
    torch.save(
        {f"module.{name}": torch.zeros(v.shape, dtype=v.dtype) for name, v in shapes.items()}, tmp_path / "w.pth"
    )
    network = load_published(tmp_path / "w.pth")
    assert (network.backbone, network.n_classes, network.device.type) == ("resnet50", 19, "cpu")


def test_files_that_hold_code_or_no_weights_are_refused(tmp_path):
    torch.save({"state_dict": {"x": Hidden()}}, tmp_path / "code.pth")
    with pytest.raises(ReadError, match=r"code.pth: cannot be read as weights without running code"):
        load_published(tmp_path / "code.pth")
    torch.save([1, 2], tmp_path / "list.pth")
    with pytest.raises(ReadError, match="holds no state dict"):
        load_published(tmp_path / "list.pth")
    with pytest.raises(ReadError, match=r"none.pth: no such weights"):
        load_published(tmp_path / "none.pth")


class Hidden:
    """An object that a pickle would have to import."""


def test_weights_that_do_not_fit_are_counted_and_named():
    network = PSPNet(4)
    state = dict(network.state_dict())
    with pytest.raises(DataError, match=r"1 weights are missing .* the first is cls.0.weight"):
        load_state(network, {name: value for name, value in state.items() if name != "cls.0.weight"})
    with pytest.raises(DataError, match=r"1 weights are unknown .* the first is layer9.weight"):
        load_state(network, {**state, "layer9.weight": torch.zeros(1)})
    with pytest.raises(DataError, match=r"of another shape .* aux.4.bias: \(5,\) instead of \(4,\)"):
        load_state(network, {**state, "aux.4.bias": torch.zeros(5)})


def test_arrays_give_the_network_back():
    network = PSPNet(5).eval()
    image = np.random.default_rng(0).integers(0, 256, (40, 56, 3), dtype=np.uint8)
    again = from_arrays(to_arrays(network), n_classes=5, backbone="small")
    assert np.array_equal(segment_image(network, image), segment_image(again, image))


def painted(n):
    """Images of a bright disc (class 1) on a noisy dark ground (class 0), and unlabelled margins."""
    rng, out = np.random.default_rng(3), []
    y, x = np.mgrid[:64, :80]
    for _ in range(n):
        inside = np.hypot(y - rng.uniform(15, 50), x - rng.uniform(15, 65)) < rng.uniform(8, 14)
        image = np.clip(rng.normal(60, 20, (64, 80, 3)) + 110 * inside[:, :, None], 0, 255).astype(np.uint8)
        labels = inside.astype(np.int16)
        labels[:3] = -1
        out.append((image, labels))
    return out


def test_training_learns_and_is_repeated_by_its_seed():
    samples = painted(12)
    network, losses = train_network(samples[:10], n_classes=2, parameters=QUICK)
    assert np.mean(losses[-5:]) < 0.5 * np.mean(losses[:5])
    for image, labels in samples[10:]:
        disc = segment_image(network, image, magnification=1.4).argmax(axis=2) == 1
        truth = labels == 1
        assert (disc & truth)[3:].sum() / (disc | truth)[3:].sum() > 0.7
    short = TrainingParameters(n_steps=2, batch_size=2, crop=33, random_state=4)
    again = [to_arrays(train_network(samples, n_classes=2, parameters=short)[0]) for _ in range(2)]
    assert all(np.array_equal(again[0][name], again[1][name]) for name in again[0])


@pytest.mark.parametrize(
    "changes", [{"optimiser": "sgd", "learning_rate": 0.05}, {"optimiser": "adamw"}, {"precision": "bfloat16"}]
)
def test_other_ways_of_training_learn_too(changes):
    way = replace(QUICK, n_steps=15, crop=33, **changes)
    _, losses = train_network(painted(8), n_classes=2, parameters=way)
    assert np.mean(losses[-5:]) < 0.8 * np.mean(losses[:5])


def test_overlap_loss_is_the_soft_iou_of_the_classes_that_are_shown():
    generator = torch.Generator().manual_seed(0)
    given = torch.softmax(torch.rand(2, 4, 6, 5, generator=generator), dim=1)
    labels = torch.randint(-1, 3, (2, 6, 5), generator=generator)  # class 3 is not shown
    iou = []
    for c in range(3):
        shared = covered = size = 0.0
        for place in np.ndindex(2, 6, 5):
            label, own = int(labels[place]), float(given[place[0], c, place[1], place[2]])
            if label >= 0:
                covered, size = covered + own, size + (label == c)
                shared += own * (label == c)
        iou.append(shared / (size + covered - shared))
    assert float(overlap_loss(given, labels)) == pytest.approx(1 - np.mean(iou), abs=1e-6)
    perfect = torch.nn.functional.one_hot(labels.clamp(min=0), 4).permute(0, 3, 1, 2).float()
    assert float(overlap_loss(perfect, labels)) == pytest.approx(0, abs=1e-6)
    assert float(overlap_loss(given, torch.full_like(labels, -1))) == 0


def test_windows_cover_the_image_and_their_means_are_probabilities():
    network = PSPNet(3).eval()
    image = np.random.default_rng(0).integers(0, 256, (50, 70, 3), dtype=np.uint8)
    out = segment_image(network, image, window=(33, 33))
    assert out.shape == (50, 70, 3)
    np.testing.assert_allclose(out.sum(axis=2), 1, atol=1e-5)
    # The corner is seen by one window alone: it is what that window says.
    corner = segment_image(network, image[:33, :33])
    np.testing.assert_allclose(out[0, 0], corner[0, 0], atol=1e-6)
    mirrored = segment_image(network, image, flip=True)
    np.testing.assert_allclose(mirrored, segment_image(network, image[:, ::-1].copy(), flip=True)[:, ::-1], atol=1e-5)


def test_magnified_image_is_seen_enlarged_and_given_back_in_its_place():
    class Reddish(torch.nn.Module):
        """Class 1 where the red is bright; notes the size that it is shown."""

        n_classes, mean, spread, device = 2, MEAN, SPREAD, torch.device("cpu")

        def forward(self, x):
            self.shown = tuple(x.shape[2:])
            return torch.cat([-9 * x[:, :1], 9 * x[:, :1]], dim=1), None

    network, image = Reddish(), np.zeros((30, 41, 3), np.uint8)
    image[8:20, 10:25, 0] = 255
    out = segment_image(network, image, magnification=1.4)
    assert network.shown == (42, 57) and out.shape == (30, 41, 2)
    wrong = (out.argmax(axis=2) == 1) != (image[:, :, 0] > 0)
    wrong[7:9, 9:26] = wrong[19:21, 9:26] = wrong[7:21, 9:11] = wrong[7:21, 24:26] = False  # at most a pixel at edges
    assert not wrong.any()
    with pytest.raises(ParameterError, match="magnification"):
        segment_image(network, image, magnification=0)
    with pytest.raises(ParameterError, match="a positive number or several, got none"):
        segment_image(network, image, magnification=())


def test_several_looks_have_the_geometric_mean_of_their_probabilities():
    torch.manual_seed(1)
    network = PSPNet(3).eval()
    image = np.random.default_rng(1).integers(0, 256, (64, 96, 3), dtype=np.uint8)
    looks = np.stack([segment_image(network, image, magnification=factor) for factor in (1, 1.5)])
    expected = np.exp(np.log(looks).mean(axis=0))
    expected /= expected.sum(axis=2, keepdims=True)
    np.testing.assert_allclose(segment_image(network, image, magnification=(1, 1.5)), expected, atol=1e-5)


def test_colours_are_centred_and_images_may_be_read_only():
    image = np.full((1, 2, 2, 3), 128, np.uint8)
    image.flags.writeable = False
    assert torch.allclose(
        network_input(image)[0, :, 0, 0],
        torch.tensor([0.0741, 0.2052, 0.4265]),
        atol=1e-3,
    )


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda: PSPNet(1), ParameterError, "n_classes must be at least 2, got 1"),
        (lambda: PSPNet(3, backbone="vgg"), ParameterError, "backbone 'vgg' is unknown"),
        (lambda: TrainingParameters(crop=8), ParameterError, "crop must be an integer >= 17, got 8"),
        (lambda: TrainingParameters(scale=(2, 1)), ParameterError, r"scale .* got \(2, 1\)"),
        (lambda: TrainingParameters(class_crops=1.5), ParameterError, r"class_crops must be in \[0, 1\], got 1.5"),
        (
            lambda: TrainingParameters(optimiser="adam"),
            ParameterError,
            "optimiser must be one of muon, adamw, .* got 'ada",
        ),
        (lambda: TrainingParameters(precision="half"), ParameterError, "precision must be one of auto, .* got 'half'"),
        (lambda: train_network([], n_classes=2), DataError, "at least one image"),
        (
            lambda: train_network(
                [(np.zeros((20, 20, 3), np.uint8), np.full((20, 20), 2))], n_classes=2, parameters=QUICK
            ),
            DataError,
            "labels of image 0 must be in -1..1, got 2..2",
        ),
        (lambda: segment_image(PSPNet(2), np.zeros((9, 9), np.uint8)), DataError, r"\(height, width, 3\)"),
        (
            lambda: segment_image(PSPNet(2), np.zeros((9, 9, 3), np.uint8), overlap=1),
            ParameterError,
            r"overlap must be in",
        ),
    ],
)
def test_what_cannot_be_trained_or_segmented_is_named(call, error, message):
    with pytest.raises(error, match=message):
        call()

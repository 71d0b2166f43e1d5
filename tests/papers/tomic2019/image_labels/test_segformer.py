"""A network of the class of SegFormer-B0 (Xie et al. 2021), tiny and with random weights: exported and imported."""

import math

import numpy as np
import pytest
import torch
from torch import nn
from torch.nn import functional

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY, ClassScheme
from mlsroad_pipeline.model_store.bundle_files import load_bundle, save_bundle
from mlsroad_pipeline.papers.tomic2019.image_labels.own_segmentation import own_model
from mlsroad_pipeline.papers.tomic2019.image_labels.pspnet import MEAN, SPREAD
from mlsroad_pipeline.papers.tomic2019.image_labels.segmentation import segmenter_of
from mlsroad_pipeline.papers.tomic2019.image_labels.training_parameters import ImageLabelsParameters

N_CLASSES = 19


class Attention(nn.Module):
    """Efficient self-attention: keys and values of a map that a convolution has reduced."""

    def __init__(self, width, heads, reduction):
        super().__init__()
        self.heads = heads
        self.query, self.both, self.out = nn.Linear(width, width), nn.Linear(width, 2 * width), nn.Linear(width, width)
        self.reduce = nn.Conv2d(width, width, reduction, reduction) if reduction > 1 else nn.Identity()
        self.norm = nn.LayerNorm(width)

    def forward(self, tokens, rows, columns):
        n, length, width = tokens.shape
        fewer = self.reduce(tokens.transpose(1, 2).reshape(n, width, rows, columns)).flatten(2).transpose(1, 2)
        keys, values = self.both(self.norm(fewer)).chunk(2, dim=-1)
        query, keys, values = (
            part.reshape(n, -1, self.heads, width // self.heads).transpose(1, 2)
            for part in (self.query(tokens), keys, values)
        )
        weights = (query @ keys.transpose(2, 3) / math.sqrt(width // self.heads)).softmax(dim=-1)
        return self.out((weights @ values).transpose(1, 2).reshape(n, length, width))


class Block(nn.Module):
    """Attention and Mix-FFN, whose depthwise convolution gives tokens their position."""

    def __init__(self, width, heads, reduction):
        super().__init__()
        self.norms = nn.ModuleList(nn.LayerNorm(width) for _ in range(2))
        self.attention = Attention(width, heads, reduction)
        self.wide, self.narrow = nn.Linear(width, 4 * width), nn.Linear(4 * width, width)
        self.depthwise = nn.Conv2d(4 * width, 4 * width, 3, padding=1, groups=4 * width)

    def forward(self, tokens, rows, columns):
        tokens = tokens + self.attention(self.norms[0](tokens), rows, columns)
        wide = self.wide(self.norms[1](tokens))
        maps = self.depthwise(wide.transpose(1, 2).reshape(len(tokens), -1, rows, columns))
        return tokens + self.narrow(functional.gelu(maps.flatten(2).transpose(1, 2)))


class SegFormer(nn.Module):
    """Four stages of overlapping patch embeddings and blocks, and an all-MLP decoder at a quarter of the size."""

    def __init__(self, widths=(8, 8, 16, 16), heads=(1, 2, 4, 8), reductions=(8, 4, 2, 1), decoder=16):
        super().__init__()
        shapes = [(7, 4), (3, 2), (3, 2), (3, 2)]
        inputs = (3, *widths)
        self.embeddings = nn.ModuleList(
            nn.Conv2d(inputs[i], widths[i], kernel, step, kernel // 2) for i, (kernel, step) in enumerate(shapes)
        )
        self.blocks = nn.ModuleList(Block(*stage) for stage in zip(widths, heads, reductions, strict=True))
        self.norms = nn.ModuleList(nn.LayerNorm(width) for width in widths)
        self.to_decoder = nn.ModuleList(nn.Linear(width, decoder) for width in widths)
        self.fuse, self.norm = nn.Conv2d(4 * decoder, decoder, 1, bias=False), nn.BatchNorm2d(decoder)
        self.classify = nn.Conv2d(decoder, N_CLASSES, 1)

    def forward(self, image):
        maps, found = image, []
        for embed, block, norm, project in zip(self.embeddings, self.blocks, self.norms, self.to_decoder, strict=True):
            maps = embed(maps)
            rows, columns = maps.shape[2:]
            tokens = norm(block(maps.flatten(2).transpose(1, 2), rows, columns))
            maps = tokens.transpose(1, 2).reshape(len(image), -1, rows, columns)
            found.append(project(tokens).transpose(1, 2).reshape(len(image), -1, rows, columns))
        size = found[0].shape[2:]
        same = [functional.interpolate(m, size=size, mode="bilinear", align_corners=False) for m in reversed(found)]
        return self.classify(torch.relu(self.norm(self.fuse(torch.cat(same, dim=1)))))


@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::torch.jit.TracerWarning")
@pytest.mark.parametrize("free", [True, False], ids=["any size", "one size"])
def test_segformer_is_imported_with_its_scores(tmp_path, rng, free):
    torch.manual_seed(1)
    network = SegFormer().eval()
    nn.init.normal_(network.classify.weight, std=5.0)  # so that classes differ
    axes = {"pixel_values": {2: "rows", 3: "columns"}, "logits": {2: "rows_4", 3: "columns_4"}} if free else None
    torch.onnx.export(
        network, (torch.zeros(1, 3, 64, 96),), tmp_path / "segformer.onnx", dynamo=False, opset_version=17,
        input_names=["pixel_values"], output_names=["logits"], dynamic_axes=axes,
    )  # fmt: skip
    names = ("road", "car", "tree", "building")
    (tmp_path / "map.csv").write_text(
        "number,class\n" + "".join(f"{number},{names[number % 4]}\n" for number in range(N_CLASSES))
    )
    members = tuple((name,) for name in names)
    scheme = ClassScheme("four", names, members, tuple(TAXONOMY.keys() - set(names)), (2, 66, 5, 6))
    parameters = ImageLabelsParameters(weights=str(tmp_path / "segformer.onnx"), classes=str(tmp_path / "map.csv"))
    save_bundle(own_model(parameters, scheme), tmp_path / "model")
    image = rng.integers(0, 256, (128, 160, 3) if free else (64, 96, 3), dtype=np.uint8)
    found = segmenter_of(load_bundle(tmp_path / "model"))(image)
    pixels = torch.from_numpy(((image - np.array(MEAN)) / np.array(SPREAD)).astype(np.float32)).permute(2, 0, 1)[None]
    with torch.no_grad():
        scores = functional.interpolate(network(pixels), size=image.shape[:2], mode="bilinear", align_corners=False)
    wanted = scores.softmax(dim=1)[0].permute(1, 2, 0).numpy()
    assert len(np.unique(wanted.argmax(axis=2))) > 2
    grouped = np.stack([wanted[..., k::4].sum(axis=2) for k in range(4)], axis=2)
    np.testing.assert_allclose(found[..., :4], grouped, atol=1e-3)

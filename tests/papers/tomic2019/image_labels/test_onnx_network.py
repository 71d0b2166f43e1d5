import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.models.machines.torch_training import warn_of_cpu
from mlsroad_pipeline.papers.tomic2019.image_labels import onnx_network
from mlsroad_pipeline.papers.tomic2019.image_labels.onnx_network import OnnxNetwork
from mlsroad_pipeline.papers.tomic2019.image_labels.segmentation import segment_image

FREE = [1, 3, "rows", "columns"]


def built(nodes, shape, *, kind=TensorProto.FLOAT, out=TensorProto.FLOAT, weights=()):
    """Build a model from `image` to `scores`."""
    graph = helper.make_graph(
        nodes, "g",
        [helper.make_tensor_value_info("image", kind, shape)],
        [helper.make_tensor_value_info("scores", out, None)],
        [numpy_helper.from_array(np.asarray(values), name) for name, values in weights],
    )  # fmt: skip
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9)
    return model.SerializeToString()


def brightest(shape=FREE, *, end=(), out=TensorProto.FLOAT):
    """Build a network whose three scores are four times the standardised colours."""
    kernel = (4 * np.eye(3, dtype=np.float32)).reshape(3, 3, 1, 1)
    last = "scores" if not end else "raw"
    nodes = [helper.make_node("Conv", ["image", "kernel"], [last]), *end]
    return built(nodes, shape, weights=[("kernel", kernel)], out=out)


@pytest.fixture
def image():
    picture = np.zeros((40, 72, 3), dtype=np.uint8)
    for k in range(3):
        picture[:, 24 * k : 24 * (k + 1), k] = 250
    return picture


def flat(**changes):
    return {"n_numbers": 3, "mean": (100, 100, 100), "spread": (50, 50, 50), **changes}


def test_scores_are_those_of_the_standardised_colours(image):
    network = OnnxNetwork(brightest(), **flat())
    assert network.n_classes == 3
    found = segment_image(network, image[:32, :64])
    log_odds = 4 * (image[:32, :64].astype(np.float64) - 100) / 50
    expected = np.exp(log_odds) / np.exp(log_odds).sum(axis=2, keepdims=True)
    np.testing.assert_allclose(found, expected, atol=1e-5)
    whole = segment_image(network, image, window=(32, 32), flip=True)  # sides are rounded to multiples of 32
    assert (whole.argmax(axis=2) == np.repeat([0, 1, 2], 24)).mean() > 0.95


@pytest.mark.parametrize(
    "model",
    [
        brightest(end=[helper.make_node("Softmax", ["raw"], ["scores"], axis=1)]),
        brightest([1, 3, 64, 96]),
        brightest(end=[helper.make_node("ArgMax", ["raw"], ["scores"], axis=1, keepdims=0)], out=TensorProto.INT64),
        built(
            [
                helper.make_node("Transpose", ["image"], ["first"], perm=[0, 3, 1, 2]),
                helper.make_node("Cast", ["first"], ["scores"], to=TensorProto.FLOAT),
            ],
            [1, 40, 72, 3], kind=TensorProto.UINT8,
        ),
    ],
    ids=["probabilities", "fixed size", "class numbers", "uint8, channels last"],
)  # fmt: skip
def test_other_inputs_and_outputs_give_the_same_classes(model, image):
    found = segment_image(OnnxNetwork(model, **flat()), image)
    assert found.shape == (40, 72, 3) and (found.argmax(axis=2) == np.repeat([0, 1, 2], 24)).mean() > 0.95


def test_what_is_no_segmentation_network_is_named(image):
    with pytest.raises(DataError, match=r"x\.onnx: cannot be read as an ONNX model"):
        OnnxNetwork(b"nothing", **flat(source="x.onnx"))
    with pytest.raises(DataError, match=r"input must be one image .* not image tensor\(float\) \[1, 5\]"):
        OnnxNetwork(built([helper.make_node("Identity", ["image"], ["scores"])], [1, 5]), **flat())
    pooled = brightest(end=[helper.make_node("ReduceMean", ["raw"], ["scores"], axes=[2, 3], keepdims=0)])
    with pytest.raises(DataError, match=r"returns float32 \(1, 3\), not scores"):
        OnnxNetwork(pooled, **flat())
    numbers = brightest(
        end=[helper.make_node("ArgMax", ["raw"], ["scores"], axis=1, keepdims=0)], out=TensorProto.INT64
    )
    last = [
        helper.make_node("ArgMax", ["raw"], ["first"], axis=1, keepdims=1),
        helper.make_node("Transpose", ["first"], ["scores"], perm=[0, 2, 3, 1]),
    ]
    with pytest.raises(DataError, match=r"x\.onnx: returns int64 \(1, 64, 64, 1\), not class numbers"):
        OnnxNetwork(brightest(end=last, out=TensorProto.INT64), **flat(source="x.onnx"))
    network = OnnxNetwork(numbers, **flat(n_numbers=2))
    with pytest.raises(DataError, match=r"returns class number 2, the class map has 2"):
        segment_image(network, image)
    with pytest.raises(ParameterError, match="device must be one of auto, cpu, cuda"):
        OnnxNetwork(brightest(), **flat(device="tpu"))
    assert onnx.__version__


def test_cuda_that_onnxruntime_replaces_by_the_cpu_is_an_error(monkeypatch):
    monkeypatch.setattr(onnx_network, "_providers", lambda _: ["CPUExecutionProvider"])
    with pytest.raises(ParameterError, match=r"x\.onnx: device is 'cuda', but onnxruntime cannot use CUDA here"):
        OnnxNetwork(brightest(), **flat(device="cuda", source="x.onnx"))


@pytest.mark.filterwarnings("ignore:Specified provider")
@pytest.mark.parametrize("fails", [False, True])
def test_a_gpu_that_onnxruntime_cannot_use_is_told_once(monkeypatch, caplog, capfd, fails):
    warn_of_cpu.cache_clear()
    wanted = ["CUDAExecutionProvider", "CPUExecutionProvider"]
    monkeypatch.setattr(onnx_network, "_providers", lambda device: wanted if device == "auto" else wanted[1:])
    session = onnx_network.onnxruntime.InferenceSession

    def failing(content, options, *, providers, **kwargs):
        if fails and len(providers) == 2:
            raise RuntimeError("CUDA failure 2: out of memory ; GPU=0")
        return session(content, options, providers=providers, **kwargs)

    monkeypatch.setattr(onnx_network.onnxruntime, "InferenceSession", failing)
    for _ in range(2):
        assert OnnxNetwork(brightest(), **flat(device="auto")).n_classes == 3
    (record,) = caplog.records
    reason = "CUDA failure 2: out of memory" if fails else "it runs with CPUExecutionProvider"
    assert f"Networks run on the CPU, which is slower: onnxruntime cannot use the GPU ({reason}" in record.message
    with pytest.raises(DataError, match="cannot be read as an ONNX model"):
        OnnxNetwork(brightest()[:50], **flat(device="auto"))
    assert capfd.readouterr() == ("", "")

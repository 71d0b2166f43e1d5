"""Device of networks: a GPU that fails is not left out without a warning."""

import logging
import warnings

import pytest
import torch

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.models.machines import torch_training
from mlsroad_pipeline.algorithms.models.machines.torch_training import find_device, reproducible
from mlsroad_pipeline.label import checks
from mlsroad_pipeline.label.checks import check_device


@pytest.fixture
def cuda(monkeypatch):
    """Return a function that sets what PyTorch finds: whether there is CUDA, its warning, and the error of its first use."""
    for cached in (torch_training._cuda_failure, torch_training.warn_of_cpu):
        cached.cache_clear()

    def found(available, warning=None, error=None):
        def is_available():
            if warning is not None:
                warnings.warn(warning, stacklevel=2)
            return available

        def zeros(*_, device):
            raise error

        monkeypatch.setattr(torch.cuda, "is_available", is_available)
        if error is not None:
            monkeypatch.setattr(torch, "zeros", zeros)

    yield found
    torch_training._cuda_failure.cache_clear()


@pytest.mark.parametrize(
    ("available", "warning", "error", "reason"),
    [
        (
            False,
            "CUDA initialization: The NVIDIA driver is too old\n (found version 10010).",
            None,
            "is too old (found",
        ),
        (True, None, RuntimeError("CUDA error: no kernel image is available\nfor execution on the device"), "image is"),
        (True, None, torch.OutOfMemoryError("CUDA out of memory."), "CUDA out of memory."),
        (True, None, AssertionError(), "AssertionError"),
    ],
)
def test_a_gpu_that_fails_is_told_once(cuda, caplog, available, warning, error, reason):
    cuda(available, warning, error)
    with caplog.at_level(logging.WARNING):
        assert [find_device("auto").type for _ in range(3)] == ["cpu"] * 3
    (record,) = caplog.records
    assert "Networks run on the CPU, which is slower: PyTorch cannot use the GPU" in record.message
    assert reason in record.message and "\n" not in record.message
    with pytest.raises(ParameterError, match=r"device is 'cuda', but PyTorch cannot use the GPU \(.*"):
        find_device("cuda")
    assert find_device("cpu").type == "cpu"


@pytest.mark.parametrize("warning", [None, "CUDA initialization: Found no NVIDIA driver on your system."])
def test_a_computer_without_a_gpu_needs_no_warning(cuda, caplog, warning):
    cuda(False, warning)
    assert find_device("auto").type == "cpu"
    assert not caplog.records
    with pytest.raises(ParameterError, match="device is 'cuda', but PyTorch finds no GPU"):
        find_device("cuda")


def toy(metadata):
    return ModelBundle("toy", {}, {"classes": ["a"], **metadata})


@pytest.mark.parametrize(
    "metadata",
    [
        {"parameters": {"device": "auto"}},
        {"parameters": {"recogniser": {"training": {"device": "auto"}}}},
        {"members": {"image_labels": {"parameters": {"device": "auto"}}}},
    ],
)
def test_label_finds_the_device_before_its_workers(cuda, caplog, monkeypatch, metadata):
    cuda(False, "CUDA initialization: out of order")
    monkeypatch.setattr(checks, "version", lambda _: "2.9.0")  # with CUDA
    check_device(toy(metadata))
    assert "Networks run on the CPU" in caplog.text
    check_device(toy({"parameters": {"device": "auto"}, "segmentation": {"source": "masks"}}))
    with pytest.raises(ParameterError, match="cannot use the GPU"):
        check_device(toy({"parameters": {"device": "cuda"}}))


def test_networks_on_the_cpu_leave_gpus_alone(monkeypatch):
    def refuse(*_):
        raise AssertionError("a GPU was used")

    for name, stand_in in (("is_available", lambda: True), ("device_count", lambda: 2), ("is_initialized", lambda: False),
                           ("get_rng_state", refuse), ("set_rng_state", refuse)):  # fmt: skip
        monkeypatch.setattr(torch.cuda, name, stand_in)
    before = torch.random.get_rng_state()
    with reproducible(3):
        first = torch.rand(4)
    with reproducible(3):
        assert torch.equal(torch.rand(4), first)
    assert torch.equal(torch.random.get_rng_state(), before)

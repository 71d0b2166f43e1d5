"""Checkpoint files: round trip, refusal of damaged files, and no partial file under the final name."""

import pytest
import torch

from mlsroad_pipeline.algorithms.core.exceptions import ReadError
from mlsroad_pipeline.model_store.torch_checkpoints import TorchCheckpoints


def test_a_state_survives_and_the_last_one_counts(tmp_path):
    checkpoints = TorchCheckpoints(tmp_path / "new" / "folder")
    assert checkpoints.load("network_0") is None
    for epoch in (1, 2):
        checkpoints.save("network_0", {"epoch": epoch, "weights": torch.full((3,), float(epoch))})
    state = checkpoints.load("network_0")
    assert state["epoch"] == 2 and state["weights"].tolist() == [2.0, 2.0, 2.0]
    assert [path.name for path in (tmp_path / "new" / "folder").iterdir()] == ["network_0.pt"]
    assert checkpoints.locate("network_0") == str(tmp_path / "new" / "folder" / "network_0.pt")


def test_an_interrupted_write_keeps_the_state_before(tmp_path, monkeypatch):
    checkpoints = TorchCheckpoints(tmp_path)
    checkpoints.save("network_0", {"epoch": 1})

    def killed(state, path):
        path.write_bytes(b"half of it")
        raise KeyboardInterrupt

    monkeypatch.setattr(torch, "save", killed)
    with pytest.raises(KeyboardInterrupt):
        checkpoints.save("network_0", {"epoch": 2})
    assert checkpoints.load("network_0") == {"epoch": 1}


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04 nothing", b"no archive at all"])
def test_damaged_files_are_refused(tmp_path, content):
    (tmp_path / "network_0.pt").write_bytes(content)
    with pytest.raises(ReadError, match=r"network_0.pt: the checkpoint is damaged"):
        TorchCheckpoints(tmp_path).load("network_0")


def test_code_in_a_checkpoint_is_not_executed(tmp_path):
    torch.save({"state": pytest.raises}, tmp_path / "network_0.pt")
    with pytest.raises(ReadError, match=r"network_0.pt: the checkpoint is damaged \(.*\)"):
        TorchCheckpoints(tmp_path).load("network_0")

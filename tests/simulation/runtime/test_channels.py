from multiprocessing import Pipe
from pathlib import Path

import numpy as np
import pytest

from mlsroad_pipeline.simulation.runtime import channels


@pytest.fixture
def channel(monkeypatch):
    monkeypatch.setattr(channels, "_SLOT", 4096)
    path = channels.create_shared_file()
    ends = Pipe()
    pair = channels.Channel(ends[0], path, 0), channels.Channel(ends[1], path, 1)
    Path(path).unlink()
    yield pair
    for end in pair:
        end.close()


def test_messages_arrive_whole_in_both_directions_at_once(channel):
    here, there = channel
    rng = np.random.default_rng(0)
    messages = [
        {
            "small": rng.random(100),
            "flat": rng.integers(0, 9, (3, 7), dtype=np.uint8),
            "text": "x",
            "none": np.zeros(0),
        },
        [rng.random(400), rng.random(112)],  # exactly one slot
        (rng.random(2000), 5),  # larger than a slot
        "no arrays",
    ]
    for first, second in (messages[:2], messages[2:], messages[1:3]):
        # Both are in transit, and both replies, before one is read.
        for message in (first, second):
            here.send(message)
            there.send((message, "back"))
        for message in (first, second):
            _same(there.receive(), message)
            _same(here.receive(), (message, "back"))


def test_received_arrays_are_not_overwritten_by_later_messages(channel):
    here, there = channel
    received = []
    for k in range(2 * channels.SLOTS + 1):
        here.send(np.full(100, k))
        received.append(there.receive())
    assert [int(a[0]) for a in received] == [int(a[-1]) for a in received] == list(range(2 * channels.SLOTS + 1))


def test_a_closed_channel_raises(channel):
    here, there = channel
    there.close()
    with pytest.raises((EOFError, OSError)):
        here.receive()


def _same(received, sent):
    assert type(received) is type(sent)
    if isinstance(sent, np.ndarray):
        np.testing.assert_array_equal(received, sent)
        assert received.dtype == sent.dtype and received.shape == sent.shape and received.flags.writeable
    elif isinstance(sent, dict):
        assert list(received) == list(sent)
        for key, value in sent.items():
            _same(received[key], value)
    elif isinstance(sent, list | tuple):
        assert len(received) == len(sent)
        for a, b in zip(received, sent, strict=True):
            _same(a, b)
    else:
        assert received == sent

from multiprocessing import Pipe
from pathlib import Path

import numpy as np
import pytest

from mlsroad_pipeline.simulation.runtime import wires


@pytest.fixture
def line(monkeypatch):
    monkeypatch.setattr(wires, "_SLOT", 4096)
    path = wires.shared_file()
    ends = Pipe()
    pair = wires.Wire(ends[0], path, 0), wires.Wire(ends[1], path, 1)
    wires.forget(path)
    assert not Path(path).exists()
    yield pair
    for end in pair:
        end.close()


def test_messages_arrive_whole_in_both_directions_at_once(line):
    here, there = line
    rng = np.random.default_rng(0)
    messages = [
        {
            "small": rng.random(100),
            "flat": rng.integers(0, 9, (3, 7), dtype=np.uint8),
            "text": "x",
            "none": np.zeros(0),
        },
        [rng.random(400), rng.random(112)],  # just as much as a slot holds
        (rng.random(2000), 5),  # more
        "no arrays",
    ]
    for first, second in (messages[:2], messages[2:], messages[1:3]):
        # Both are on their way, and both answers, before one is read.
        for message in (first, second):
            here.send(message)
            there.send((message, "back"))
        for message in (first, second):
            _same(there.receive(), message)
            _same(here.receive(), (message, "back"))


def test_what_was_received_is_not_overwritten_by_what_comes_later(line):
    here, there = line
    received = []
    for k in range(2 * wires.SLOTS + 1):
        here.send(np.full(100, k))
        received.append(there.receive())
    assert [int(a[0]) for a in received] == [int(a[-1]) for a in received] == list(range(2 * wires.SLOTS + 1))


def test_a_line_that_is_cut_says_so(line):
    here, there = line
    there.close()
    with pytest.raises((EOFError, OSError)):
        here.receive()


def _same(found, wanted):
    assert type(found) is type(wanted)
    if isinstance(wanted, np.ndarray):
        np.testing.assert_array_equal(found, wanted)
        assert found.dtype == wanted.dtype and found.shape == wanted.shape and found.flags.writeable
    elif isinstance(wanted, dict):
        assert list(found) == list(wanted)
        for key, value in wanted.items():
            _same(found[key], value)
    elif isinstance(wanted, list | tuple):
        assert len(found) == len(wanted)
        for a, b in zip(found, wanted, strict=True):
            _same(a, b)
    else:
        assert found == wanted

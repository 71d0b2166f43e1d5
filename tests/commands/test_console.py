"""Terminal output of `mlsroad`."""

import io

import pytest
from rich.console import Console

from mlsroad_pipeline.commands import console
from mlsroad_pipeline.commands.console import Stages, survey_progress


@pytest.fixture
def clock(monkeypatch):
    """A clock that the test sets."""
    now = [0.0]
    monkeypatch.setattr(console, "LINE_INTERVAL", 30.0)
    monkeypatch.setattr(console.time, "monotonic", lambda: now[0])
    return now


def test_a_log_file_has_a_line_of_progress_per_interval(clock):
    out = io.StringIO()
    stages = Stages({"pieces": ("Cutting into scenes", 0.4), "results": ("Labelling", 0.6)}, Console(file=out))
    cutting = stages.start("pieces", 4)
    for seconds in (10, 20, 40, 45):
        clock[0] = seconds
        cutting.step()
    labelling = stages.start("results", 2)
    clock[0] = 70
    labelling.step()
    assert out.getvalue() == (
        "Cutting into scenes: 30 %, about 93 s left\n"  # 40 s for 0.3
        "Labelling: 70 %, about 30 s left\n"
    )
    clock[0] = 200
    labelling.step()  # nothing is left
    assert out.getvalue().count("\n") == 2


def test_a_simulation_in_a_log_file_has_lines_in_metres(clock):
    out = io.StringIO()
    with survey_progress(Console(file=out), 60.0) as move:
        for seconds, distance in ((10, 15.0), (30, 20.0), (60, 60.0)):
            clock[0] = seconds
            move(distance)
    assert out.getvalue() == "Simulating: 20 of 60 m, about 60 s left\n"

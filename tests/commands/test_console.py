"""Terminal output of `mlsroad`, and errors in one line."""

import errno
import io
import threading

import pytest
import typer
from kedro.io import DatasetError
from kedro.validation import ParameterValidationError
from rich.console import Console

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError, ReadError
from mlsroad_pipeline.commands import console
from mlsroad_pipeline.commands.app import write_any_character
from mlsroad_pipeline.commands.console import Compiling, Stages, describe, one_line_errors, survey_progress
from mlsroad_pipeline.commands.options import expanded
from mlsroad_pipeline.execution.task import SceneError, SceneFailure


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


def test_a_first_run_counts_its_kernels_and_then_estimates_from_what_followed(clock):
    out, counted = io.StringIO(), threading.Event()

    def compiled():
        clock[0] += 40  # the next interval
        if clock[0] > 100:
            counted.set()
        return int(clock[0])

    compiling = Compiling(compiled, 200, until="Labelling")
    stages = Stages({"pieces": ("Cutting", 0.4), "results": ("Labelling", 0.6)}, Console(file=out), compiling=compiling)
    with stages.shown():
        stages.start("pieces", 1).step()
        assert counted.wait(20)
        labelling = stages.start("results", 3)
        labelling.step()
        clock[0] += 50
        labelling.step()
    lines = out.getvalue().splitlines()
    assert lines[:2] == [f"Compiling, once: {number} of about 200 kernels" for number in (40, 80)]
    assert lines[-1] == "Labelling: 80 %, about 50 s left"  # 0.2 in 50 s, not in all of the time


def test_a_simulation_in_a_log_file_has_lines_in_metres(clock):
    out = io.StringIO()
    with survey_progress(Console(file=out), 60.0) as move:
        for seconds, distance in ((10, 15.0), (30, 20.0), (60, 60.0)):
            clock[0] = seconds
            move(distance)
    assert out.getvalue() == "Simulating: 20 of 60 m, about 60 s left\n"


def caused(error, cause):
    try:
        raise error from cause
    except type(error) as raised:
        return raised


def test_the_projects_own_error_is_shown_and_not_what_kedro_wraps_it_in():
    own = ReadError("/data/a.las: header ends after 3 bytes")
    assert describe(caused(DatasetError("Failed while loading\n'label'"), own)) == str(own)


def test_a_missing_package_is_named():
    lacking = ModuleNotFoundError("No module named 'torch'", name="torch")
    assert "the package torch," in describe(caused(DatasetError("Failed"), lacking))


def test_a_failed_stage_names_its_first_scenes():
    failures = tuple(SceneFailure(f"s{i}", f"/data/{i}.laz", f"cause\n{i}") for i in range(5))
    text = describe(caused(DatasetError("store"), SceneError("results", failures, 9)))
    assert "\n" not in text
    assert text.endswith("; and 2 more scenes")
    assert [f"/data/{i}.laz" in text for i in range(5)] == [True, True, True, False, False]


def test_an_own_error_that_names_its_file_stands_alone():
    source = "/data/empty.laz"
    own = SceneFailure("survey.empty_laz", source, f"ReadError: {source} is empty (0 bytes)")
    assert describe(SceneError("files", (own,), 1)) == f"{source} is empty (0 bytes)"
    elsewhere = SceneFailure("survey.empty_laz", source, "ReadError: no point is left")
    foreign = SceneFailure("survey.empty_laz", source, f"ValueError: {source} (las.py:3, in read)")
    scene = SceneFailure("survey._.scene_00002", "model", "DataError: a.laz (scene_00002): class 9 is not in asprs")
    assert describe(SceneError("labels", (scene,), 1)) == "a.laz (scene_00002): class 9 is not in asprs"
    for failure in (elsewhere, foreign):
        assert describe(SceneError("files", (failure,), 1)) == str(failure)


def test_an_error_of_the_system_names_the_file():
    full = OSError(errno.ENOSPC, "No space left on device", "/out/a.laz")
    assert describe(caused(RuntimeError("writer"), full)).startswith("/out/a.laz: No space left on device: free some")


def test_a_refused_parameter_is_shown_without_what_kedro_wraps_it_in():
    text = "- Parameter 'label': Failed to instantiate LabelParameters for parameter 'label': label.copc must be true"
    assert describe(ParameterValidationError(text)) == "label.copc must be true"


def test_a_working_folder_that_is_gone_is_named(capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    tmp_path.rmdir()
    with pytest.raises(SystemExit), one_line_errors(verbose=False):
        pass
    assert "the working folder does not exist any more" in capsys.readouterr().err


def test_colons_of_a_name_are_no_emoji(capsys):
    with pytest.raises(SystemExit), one_line_errors(verbose=False):
        raise ReadError("a:x:b.las is empty")
    assert "a:x:b.las" in capsys.readouterr().err


def test_a_wrong_command_line_is_left_to_typer():
    with pytest.raises(typer.BadParameter), one_line_errors(verbose=False):
        expanded([""])


def test_any_other_error_names_its_type_and_how_to_see_more():
    assert describe(KeyError("run")) == "KeyError: 'run' (--verbose shows the traceback)"
    assert describe(ValueError()) == "ValueError: no message (--verbose shows the traceback)"


@pytest.mark.parametrize(
    ("error", "code", "text"),
    [
        (ParameterError("label.crs 'x' is no system"), 1, "Error: label.crs 'x' is no system"),
        (KeyboardInterrupt(), 130, "Interrupted. The same command continues from here."),
    ],
)
def test_the_exit_code_and_the_line(capsys, error, code, text):
    with pytest.raises(SystemExit) as ended, one_line_errors(verbose=False):
        raise error
    assert ended.value.code == code
    assert capsys.readouterr().err.strip() == text


def test_verbose_prints_the_traceback_first(capsys):
    with pytest.raises(SystemExit), one_line_errors(verbose=True):
        raise ParameterError("bad")
    lines = capsys.readouterr().err.strip().splitlines()
    assert lines[0].startswith("Traceback")
    assert lines[-1] == "Error: bad"


def test_no_password_and_no_control_character_is_shown():
    foreign = RuntimeError("request to https://ann:secret@registry/api failed with \x1b[31mtoken=abc")
    text = describe(foreign)
    assert "secret" not in text and "abc" not in text and "\x1b" not in text
    assert "https://ann:***@registry/api failed with \\x1b[31mtoken=***" in text
    assert describe(ReadError("/data/a\x1b[2J\nb.laz: is empty")) == "/data/a\\x1b[2J b.laz: is empty"


@pytest.mark.parametrize(
    ("encoding", "written"),
    [("ascii", "points per m2, Strasse ? a ?"), ("latin-1", "points per m\u00b2, Strasse ? \u00e4 ?"), ("utf-8", None)],
)
def test_a_terminal_of_few_characters_gets_like_ones(encoding, written):
    text = "points per m\u00b2, Strasse \u2502 \u00e4 \u4e2d"
    stream = io.TextIOWrapper(io.BytesIO(), encoding=encoding)
    write_any_character(stream)
    stream.write(text)
    stream.flush()
    assert stream.buffer.getvalue().decode(encoding) == (written or text)

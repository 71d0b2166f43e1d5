"""The commands that the README and the manual give: they parse, and the cheap ones run with a clean stderr."""

import contextlib
import os
import re
import subprocess
import sys

import click
import laspy
import numpy as np
import pyogrio
import pytest
import typer
from helpers.conf import CONF, from_command_line
from helpers.documented import documented_commands
from helpers.wiring import REPOSITORY, make_project
from helpers.yaml_files import read_yaml
from kedro.framework.project import configure_project

from mlsroad_pipeline import cli
from mlsroad_pipeline.commands.app import app
from mlsroad_pipeline.config import loader
from mlsroad_pipeline.execution.parameter_checks import check_names
from mlsroad_pipeline.formats.las.header import class_names, read_header
from mlsroad_pipeline.pipelines.composition import pipeline_names

COMMANDS = documented_commands()
OWN = {"mine", "myproject"}
"""Environments that a reader makes while following a page."""
OWN_PIPELINES = {"my_forest"}
"""The method that `docs/how_to/add_a_method.md` adds."""
LIBRARY_WARNING = re.compile(r"\w*Warning\b|warn\(")


def base_parameters():
    parameters = {}
    for path in (CONF / "base").glob("parameters*.yml"):
        parameters |= read_yaml(path)
    return parameters


def ids(command):
    return f"{command.page}: {command.text[:70]}"


@pytest.fixture(scope="module")
def base():
    return base_parameters()


def test_the_manual_gives_commands_of_both_programs():
    programs = [command.arguments[:2] for command in COMMANDS]
    assert len(programs) > 60 and {("kedro", "run"), ("mlsroad", "label")} <= set(programs)


@pytest.mark.parametrize("command", [c for c in COMMANDS if c.arguments[:2] == ("kedro", "run")], ids=ids)
def test_kedro_commands_have_known_options_pipelines_environments_and_parameters(command, base, monkeypatch):
    configure_project("mlsroad_pipeline")  # as `kedro` does
    monkeypatch.setattr(loader, "check_environment", lambda *_: None)  # those of the user are no folders here
    options = [option.removesuffix(",...") for option in command.arguments[2:]]
    assert not {"-p", "--pipeline", "--async"} & {option.partition("=")[0] for option in options}
    with contextlib.chdir(REPOSITORY):
        given = cli.run.make_context("run", options).params
    assert set(given["pipelines"]) <= {*pipeline_names(), *OWN_PIPELINES}, given["pipelines"]
    assert given["env"] in {None, *OWN} or (CONF / given["env"]).is_dir(), given["env"]
    parameters = given["params"] if isinstance(given["params"], dict) else from_command_line(given["params"] or "")
    check_names(parameters, base, command.text)


@pytest.mark.parametrize("command", [c for c in COMMANDS if c.arguments[0] == "mlsroad"], ids=ids)
def test_mlsroad_commands_have_known_options(command):
    group = typer.main.get_command(app)
    name, *options = command.arguments[1:] if len(command.arguments) > 1 else ["--help"]
    if name.startswith("-"):
        assert group.make_parser(click.Context(group)).parse_args([name]) is not None
        return
    if name == "COMMAND":
        return
    assert name in group.commands, name
    group.commands[name].make_parser(click.Context(group.commands[name])).parse_args(options)


# ---- commands as a user types them, on a tiny survey


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    """A project with a folder `in`: a cloud with 8-bit intensities and withheld points, and two files without points."""
    folder = make_project(tmp_path_factory.mktemp("typed"), tiny=False)
    rng = np.random.default_rng(5)
    las = laspy.LasData(laspy.LasHeader(version="1.4", point_format=6))
    las.header.scales, las.header.offsets = [0.001] * 3, [389_300, 5_819_700, 0]
    las.x, las.y, las.z = (rng.random((3000, 3)) * [12, 6, 3] + [389_300, 5_819_700, 34]).T
    las.intensity, las.withheld = rng.integers(0, 256, 3000), np.arange(3000) < 5
    las.gps_time = np.sort(rng.random(3000))
    (folder / "in").mkdir()
    las.write(folder / "in/street.las")
    (folder / "in/empty.las").write_bytes(b"")
    (folder / "in/labels.txt").write_text("1 car\n2 tree\n", encoding="utf-8")
    return folder


def typed(project, *words):
    """Run a command in the project's folder, and return the result with the lines of stderr."""
    program = {"kedro": ["-m", "kedro"], "mlsroad": ["-c", "from mlsroad_pipeline.commands.app import main; main()"]}
    environment = {**os.environ, "PYTHONPATH": str(REPOSITORY / "src"), "COLUMNS": "200"}
    for name in ("MLFLOW_TRACKING_URI", "PYTHONWARNINGS", "KEDRO_LOGGING_CONFIG"):
        environment.pop(name, None)
    command = [sys.executable, *program[words[0]], *words[1:]]
    done = subprocess.run(command, cwd=project, env=environment, capture_output=True, text=True, check=False)
    return done, done.stderr.splitlines()


SAID = (
    "empty.las: is empty (0 bytes): skipped",
    "labels.txt: is a table beside point clouds of another format: skipped",
    "street.las: no coordinate reference system",
    "street.las: no trajectory",
    "street.las: 5 points are flagged withheld",
    "street.las: intensity has 8 bits",
)


def test_kedro_run_inspect_says_what_is_unusual_and_where_its_report_lies(project):
    done, lines = typed(project, "kedro", "run", "--pipelines=inspect", "--params=inspect.survey=in")
    assert done.returncode == 0, done.stderr
    assert not [line for line in lines if LIBRARY_WARNING.search(line)], done.stderr
    for text in SAID:
        assert sum(text in line for line in lines) == 1, (text, done.stderr)
    assert lines[-1].endswith(f"Report: {project / 'data/08_reporting/inspection.html'}")


def test_mlsroad_inspect_says_the_same_with_nothing_on_stderr(project):
    done, _ = typed(project, "mlsroad", "inspect", "in", "-o", "quality")
    assert done.returncode == 0 and done.stderr == "", done.stderr
    for text in SAID:
        assert done.stdout.count(text) == 1, (text, done.stdout)
    assert done.stdout.splitlines()[-1] == "Report: quality/inspection.html"


def test_mlsroad_label_assigns_a_system_and_says_the_same_with_nothing_on_stderr(project):
    here = ("--params", "execution.backend=sequential")  # tests/commands/test_mlsroad.py labels with workers
    done, _ = typed(project, "mlsroad", "label", "in", "-o", "out", "--crs", "EPSG:28992", "--copc", *here)
    assert done.returncode == 0 and done.stderr == "", done.stderr
    for text in SAID:
        assert done.stdout.count(text) == (0 if "reference system" in text else 1), (text, done.stdout)
    report = (project / "out/report.html").read_text(encoding="utf-8")
    assert "labels.txt: is a table beside point clouds of another format: skipped" in report
    for name in ("street.laz", "street.copc.laz"):
        with laspy.open(project / "out" / name) as reader:
            assert reader.header.parse_crs().to_epsg() == 28992
            assert class_names(read_header(project / "out" / name))[64] == "pole"
    assert pyogrio.read_info(project / "out/inventory.gpkg", layer="objects")["crs"] == "EPSG:28992"


def test_misspelt_section_is_the_last_line_of_the_command(project):
    done, lines = typed(project, "kedro", "run", "--pipelines=label", "--params=labl.survey=in")
    assert done.returncode != 0 and lines[-1].endswith("--params: unknown section labl; did you mean label?")
    assert not [line for line in lines if "UserWarning" in line or "DeprecationWarning" in line], done.stderr

"""Misspelt sections and keys of parameters, and configuration files: errors of one line with the nearest right name."""

import click
import pytest
import yaml
from click.testing import CliRunner
from helpers.conf import from_command_line, parameters_of
from helpers.wiring import REPOSITORY, last_line, make_project
from kedro.framework.project import configure_project

from mlsroad_pipeline import cli
from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.config import ParameterConfigLoader


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    return make_project(tmp_path_factory.mktemp("conf"), tiny=False)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("labl.survey=a.laz", "--params: unknown section labl; did you mean label?"),
        ("label.survy=a.laz", "--params: unknown parameter label.survy; did you mean label.survey?"),
        ("label=3", "--params: label is a section, got 3: set parameters below it"),
        ("exekution.n_workers=2", "--params: unknown section exekution; did you mean execution?"),
        ("foo.bar=1", "--params: unknown section foo; known: "),
        ("simulation.survey.mine.length=4", "unknown parameter simulation.survey; did you mean simulation.surveys?"),
    ],
)
def test_misspelt_name_on_the_command_line(project, text, message):
    with pytest.raises(ParameterError) as caught:
        parameters_of(project, **from_command_line(text))
    assert message in last_line(caught.value)


def test_misspelt_name_in_a_file_of_an_environment(tmp_path):
    folder = make_project(tmp_path, tiny=False)
    file = folder / "conf/local/parameters.yml"
    file.write_text(yaml.safe_dump({"inspekt": {"survey": "a.laz"}}), encoding="utf-8")
    with pytest.raises(ParameterError) as caught:
        parameters_of(folder, "local")
    assert str(file) in str(caught.value) and "unknown section inspekt; did you mean inspect?" in str(caught.value)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("run: {pipelins: label}", "unknown option run.pipelins; did you mean pipelines?"),
        ("run: label", "`run:` holds no options such as `pipelines` and `params`"),
        ("- label", "it holds neither options under `run:` nor sections of parameters"),
        ("{", "while parsing a flow node"),
    ],
)
def test_file_that_describes_no_run_is_an_error_of_one_line(tmp_path, content, message):
    file = tmp_path / "mine.yml"
    file.write_text(content, encoding="utf-8")
    result = CliRunner().invoke(cli.run, [f"--config={file}"])
    assert result.exit_code != 0 and message in result.output and "Traceback" not in result.output


@pytest.mark.parametrize("name", ["tiny", "quick"])
def test_configurations_of_the_project_are_options_of_the_command(project, name):
    options = cli.options_of((REPOSITORY / f"conf/{name}.yml").read_text(encoding="utf-8"))
    assert set(options) <= {parameter.name for parameter in cli.run.params}
    assert parameters_of(project, **options["params"])["detrended_forest"].n_trees > 0


@pytest.mark.parametrize("given", [["--env=semantikitti"], []])
def test_unknown_environment_is_one_line_that_names_those_there_are(project, monkeypatch, given):
    configure_project("mlsroad_pipeline")  # as `kedro` does
    monkeypatch.chdir(project)
    monkeypatch.setenv("KEDRO_ENV", "" if given else "semantikitti")
    result = CliRunner().invoke(cli.run, given)
    assert result.exit_code == 1 and result.output.count("\n") == 1
    assert result.output.startswith("Error: unknown environment 'semantikitti' (known: base, ")
    with pytest.raises(click.ClickException, match="unknown environment 'semantikitti' "):  # of all other commands
        ParameterConfigLoader(str(project / "conf"), env="semantikitti", base_env="base", default_run_env="local")


def test_unknown_pipeline_is_one_line_that_names_those_there_are(project, monkeypatch):
    configure_project("mlsroad_pipeline")
    monkeypatch.chdir(project)
    result = CliRunner().invoke(cli.run, ["--pipelines=lable"])
    assert result.exit_code == 1 and result.output.count("\n") == 1
    assert result.output.startswith("Error: unknown pipeline 'lable' (known: all_methods, ")


@pytest.mark.parametrize("order", [1, -1])
def test_parameters_of_the_command_replace_those_of_the_file_and_keep_the_rest(tmp_path, order):
    file = tmp_path / "mine.yml"
    file.write_text("ingest: {scene_length: 15.0, buffer: 2.0}\nlabel: {copc: true}", encoding="utf-8")
    given = [f"--config={file}", "--params=ingest.scene_length=20.0,label.survey=007"]
    with cli.run.make_context("run", given[::order]) as context:
        assert context.params["params"] == {
            "ingest": {"scene_length": 20.0, "buffer": 2.0}, "label": {"copc": True, "survey": "007"},
        }  # fmt: skip

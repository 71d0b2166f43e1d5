"""Names of runs, models and runners."""

import pytest
from kedro.io import DataCatalog, MemoryDataset
from kedro.pipeline import Node, Pipeline
from kedro.runner import SequentialRunner

from mlsroad_pipeline.hooks.run_details import model_name, run_name, runner_name, typed_command


def named(parameter, value, pipeline_names=None, **others):
    pipeline = Pipeline([Node(len, f"params:{parameter}", "n", name="count")])
    entries = {f"params:{name}": MemoryDataset(content) for name, content in {parameter: value, **others}.items()}
    return run_name({"pipeline_names": pipeline_names}, pipeline, DataCatalog(entries))


@pytest.mark.parametrize(
    ("survey", "expected"),
    [
        ("/data/street_1M.laz", "label street_1M.laz"),
        ("/data/drives/", "label drives"),
        (["a/x.laz", "b/y.laz", "z.laz"], "label x.laz and 2 more"),
        ("", "label"),
    ],
)
def test_a_labelling_is_named_after_its_files(survey, expected):
    assert named("label", {"survey": survey}, ["label"]) == expected


def test_a_comparison_is_named_after_the_folder_of_its_survey():
    survey = {"root": "/data/oakland"}
    assert named("survey", survey) == "compare oakland"
    assert named("survey", survey, default_pipeline="all_methods") == "all_methods oakland"
    assert named("survey", survey, ["ground_removal", "segmentation"]) == "ground_removal+segmentation oakland"
    assert named("other", {}, ["simulate"]) == "simulate"


@pytest.mark.parametrize(
    ("model", "expected"),
    [
        ({"name": "mlsroad-patch_forest", "version": 3, "source": "registered"}, "patch_forest version 3"),
        ({"name": "dense", "version": "0.3.0", "source": "shipped"}, "dense"),
        ({"name": "fusion", "version": ""}, "fusion"),
    ],
)
def test_a_model_has_its_name_and_a_registered_one_its_version(model, expected):
    assert model_name(model) == expected


def test_a_runner_has_the_name_of_its_class():
    assert runner_name(str(SequentialRunner())) == "SequentialRunner"
    assert runner_name("kedro.runner.ThreadRunner") == "ThreadRunner"
    assert [runner_name(none) for none in (None, "None", "")] == ["SequentialRunner"] * 3


def test_the_command_is_one_that_can_be_typed():
    assert typed_command("kedro run --pipeline=label", None) == "kedro run --pipelines=label"
    assert typed_command("kedro run --pipeline=__default__", "oakland") == "kedro run --env=oakland"


@pytest.mark.parametrize("program", ["/venv/bin/kedro", "/lib/kedro/__main__.py"])
def test_a_command_is_recorded_as_typed(program):
    argv = [program, "run", "--config=own settings.yml", "--params=a.b=1"]
    assert typed_command("kedro run", None, argv) == "kedro run '--config=own settings.yml' --params=a.b=1"
    assert typed_command("kedro run", None, ["/venv/bin/pytest", "-q"]) == "kedro run"

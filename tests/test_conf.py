"""The configuration agrees with the code in every environment."""

import dataclasses
import re
import shutil

import pytest
from helpers.conf import CONF, base, configured, parameters_of
from helpers.wiring import REPOSITORY, joined, make_project
from helpers.yaml_files import read_yaml
from kedro.framework.project import pipelines

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY, ClassScheme
from mlsroad_pipeline.algorithms.core.codings import Coding
from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.config import ParameterConfigLoader
from mlsroad_pipeline.simulation.parameters.presets import simulation_parameters
from mlsroad_pipeline.surveys.parameters import SurveyParameters

ENVIRONMENTS = sorted(path.name for path in CONF.iterdir() if path.is_dir() and path.name != "local")


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    return make_project(tmp_path_factory.mktemp("conf"), tiny=False)


@pytest.fixture(autouse=True, scope="module")
def _some_data(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MLSROAD_DATA", str(tmp_path_factory.mktemp("data")))
        yield


def test_make_run_runs_every_method_at_the_quick_scale(project):
    quick = read_yaml(CONF / "quick.yml")["run"]
    assert "kedro run --config=conf/quick.yml" in (REPOSITORY / "Makefile").read_text(encoding="utf-8")
    parameters = parameters_of(project, **quick["params"])
    assert pipelines[quick["pipelines"]].nodes
    assert parameters["image_labels"].network.n_steps == quick["params"]["image_labels"]["network"]["n_steps"]
    assert parameters["detrended_forest"].n_trees == base("detrended_forest")["n_trees"]
    assert parameters["jointnet"].training.epochs < base("jointnet")["training"]["epochs"]


@pytest.mark.parametrize("env", ENVIRONMENTS)
def test_every_dataset_of_every_pipeline_can_be_made(project, env):
    catalog, names = configured(project, env)[0], set()
    for name in pipelines:
        names |= pipelines[name].datasets() if pipelines[name] else set()
    assert len(names) > 30
    for name in sorted(names):
        assert catalog.get(name) is not None, name
        if name.startswith("params:"):
            catalog.load(name)
    # what stages exchange is stored, so that a run can be resumed; only plans, and what merely joins
    # stored results, stay in memory
    in_memory = {n for n in names if type(catalog.get(n)).__name__ == "MemoryDataset" and not n.startswith("params:")}
    plans = {"survey_plan", "label_plan", "luo2016_study.plan", "luo2019_study.plan", "recordings_study.plan",
             "tomic2019_study.plan", "yu2016_study.plan"}  # fmt: skip
    assert in_memory == {
        *plans,
        "image_labels.drives",
        "label_exports",
        "label_found_inventory",
        "label_pictures",
        "label_facts",
        "label_offsets",
        "label_images",
        "label_model_request",
        "label_read_quality",
        "label_quality",
        "label_warnings",
        "patch_training",
    }


def paths_below_data(env, catalog):
    for name in ("scenes", "detrended_forest.labels", "detrended_forest.scores", "comparison"):
        described = catalog.get(name)._describe()["filepath"]
        yield re.search(r"data/\d\d_\w+/(\w+)", str(described))[1]


@pytest.mark.parametrize("env", ENVIRONMENTS)
def test_environments_keep_their_data_apart(project, env):
    folders = set(paths_below_data(env, configured(project, env)[0]))
    assert (folders == {env}) if env != "base" else (env not in folders)


@pytest.mark.parametrize("env", ENVIRONMENTS)
def test_schemes_cover_what_the_coding_can_give_and_nest(project, env):
    parameters = configured(project, env)[1]
    survey, classes = parameters["survey"], parameters["classes"]
    coding = classes["codings"][survey.coding]
    codes = list(TAXONOMY.values()) if coding is None else [TAXONOMY[name] for name in coding.values()]
    trained = ClassScheme.from_config(survey.scheme, classes["schemes"][survey.scheme])
    assert set(trained.encode(codes).tolist()) >= set(range(len(trained))) or env == "oakland"
    if survey.evaluation_scheme:
        scored = ClassScheme.from_config(survey.evaluation_scheme, classes["schemes"][survey.evaluation_scheme])
        scored.encode(codes)
        assert set(trained.coarsen(scored).tolist()) == set(range(len(scored)))


def schemes_and_codings():
    classes = base("classes")
    return classes["schemes"], {name: codes for name, codes in classes["codings"].items() if codes}


@pytest.mark.parametrize("name", schemes_and_codings()[0])
def test_scheme_builds_and_writes_codes_that_las_has(name):
    scheme = ClassScheme.from_config(name, schemes_and_codings()[0][name])
    standard = {1, 2, 3, 4, 5, 6, 7, 9, 10, 11, 13, 14, 15, 16, 17, 18}  # LAS 1.4 R15, table 17, less the reserved
    assert set(scheme.asprs) <= standard | set(range(64, 256))
    assert not set(scheme.ignored) & {member for group in scheme.members for member in group}


@pytest.mark.parametrize("name", ["tomic2019", "road_inventory", "common", "luo2016", "asprs"])
def test_general_schemes_name_the_whole_taxonomy(name):
    ClassScheme.from_config(name, schemes_and_codings()[0][name]).encode(list(TAXONOMY.values()))


@pytest.mark.parametrize("name", ["oakland5", "oakland7"])
def test_oakland_schemes_name_all_that_its_coding_gives(name):
    scheme = ClassScheme.from_config(name, schemes_and_codings()[0][name])
    coding = Coding("oakland", schemes_and_codings()[1]["oakland"])
    scheme.encode(coding.encode(sorted(coding.codes)))


def test_oakland5_is_the_usual_protocol():
    """Munoz et al. 2009: wire, pole with trunks, ground, facade, vegetation; the rest is ignored."""
    protocol = {
        "wire": [*range(1100, 1103)],
        "pole": [1103, 1104, *range(1106, 1109), *range(1110, 1111), 1112, *range(1114, 1119), 1302, 1303],
        "ground": [1200, *range(1202, 1207), 1301],
        "facade": [*range(1400, 1413)],
        "vegetation": [1004, 1300, 1304, 1305, 1306],
    }
    scheme = ClassScheme.from_config("oakland5", schemes_and_codings()[0]["oakland5"])
    coding = Coding("oakland", schemes_and_codings()[1]["oakland"])
    for code in coding.codes:
        label = int(scheme.encode(coding.encode([code]))[0])
        found = None if label < 0 else scheme.classes[label]
        expected = next((name for name, codes in protocol.items() if code in codes), None)
        assert found == expected, (code, coding.codes[code])


def test_simulated_surveys_are_presets_with_known_changes():
    found = [simulation_parameters(config) for config in base("simulation")["surveys"].values()]
    assert len({parameters.seed for parameters in found}) == len(found)  # no method is scored on the street it knows


def test_environments_inherit_what_they_do_not_change(project):
    changed, plain = configured(project, "oakland")[1], configured(project, "base")[1]
    assert changed["survey"].scheme == "oakland5" and changed["ingest"].cut == "file"
    assert changed["ingest"] == dataclasses.replace(plain["ingest"], cut="file")
    assert changed["survey"].splits["train"] == "*_a[cehjkm].xyz_label_conf.gz"
    assert joined(changed["simulation"], {"enabled": True}) == plain["simulation"]


def test_unknown_coding_is_named():
    survey = SurveyParameters(root="x", splits={}, scheme="s", coding="martian")
    with pytest.raises(ParameterError, match=r"'martian' is not configured \(codings: taxonomy, oakland"):
        survey.options(base("classes")["codings"])


def test_configuration_of_a_package_needs_no_local_environment(tmp_path):
    shutil.copytree(REPOSITORY / "conf" / "base", tmp_path / "base")
    loader = ParameterConfigLoader(str(tmp_path), base_env="base", default_run_env="local", env=None)
    assert loader["parameters"]["label"] and loader["catalog"]["comparison"]["filepath"].startswith("data/")

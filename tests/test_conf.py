"""The configuration: what it says is what the code takes, in every environment and from the command line."""

import ast
import dataclasses
import re
from pathlib import Path

import pytest
import yaml
from kedro.framework.cli.utils import _split_params
from kedro.framework.project import pipelines
from kedro.io import DatasetError
from numpydoc.docscrape import ClassDoc
from references_wiring import REPOSITORY, joined, last_line, make_project, session_of

from mlsroad_pipeline.algorithms.baselines.bottom_up_top_down import BottomUpTopDownParameters
from mlsroad_pipeline.algorithms.baselines.descriptor_machine import DescriptorParameters
from mlsroad_pipeline.algorithms.baselines.hough_forest import HoughForestParameters
from mlsroad_pipeline.algorithms.baselines.max_margin_training import MarginParameters
from mlsroad_pipeline.algorithms.baselines.object_matching import ObjectMatchingParameters
from mlsroad_pipeline.algorithms.baselines.patch_forest import PatchForestParameters
from mlsroad_pipeline.algorithms.baselines.patch_svm import PatchSvmParameters
from mlsroad_pipeline.algorithms.baselines.pointnet_parameters import PointNetParameters
from mlsroad_pipeline.algorithms.baselines.shape_based import ShapeParameters
from mlsroad_pipeline.algorithms.classes import TAXONOMY, ClassScheme, Coding
from mlsroad_pipeline.algorithms.detection import DetectionParameters
from mlsroad_pipeline.algorithms.detrended_forest.training import ForestParameters
from mlsroad_pipeline.algorithms.exceptions import ParameterError
from mlsroad_pipeline.algorithms.fusion.labeller import FusionParameters
from mlsroad_pipeline.algorithms.fusion.log_linear_pool import PoolParameters
from mlsroad_pipeline.algorithms.image_labels.training_parameters import ImageLabelsParameters, TrainingParameters
from mlsroad_pipeline.algorithms.ingest import IngestParameters, OutlierParameters
from mlsroad_pipeline.algorithms.jointnet.parameters import JointNetParameters
from mlsroad_pipeline.algorithms.object_segmentation import SegmentationParameters
from mlsroad_pipeline.algorithms.patch_graph.classifier import PatchGraphParameters
from mlsroad_pipeline.algorithms.patch_graph.refined_classifier import GridParameters
from mlsroad_pipeline.algorithms.patches import PatchParameters
from mlsroad_pipeline.algorithms.recognition_objects import RecognitionParameters
from mlsroad_pipeline.algorithms.scene_stages import FeatureParameters, GroundParameters, SupervoxelParameters
from mlsroad_pipeline.algorithms.studies.luo2016_parameters import StudyParameters
from mlsroad_pipeline.algorithms.studies.luo2019_parameters import StudyParameters as Luo2019StudyParameters
from mlsroad_pipeline.algorithms.studies.luo2019_set_parameters import SimulatedObjectsParameters
from mlsroad_pipeline.algorithms.studies.tomic2019_parameters import StudyParameters as Tomic2019StudyParameters
from mlsroad_pipeline.algorithms.studies.yu2016_parameters import StudyParameters as Yu2016StudyParameters
from mlsroad_pipeline.algorithms.visual_words.training import VisualWordsParameters
from mlsroad_pipeline.datasets.inspect_work import InspectParameters
from mlsroad_pipeline.datasets.simulated_survey import simulation_parameters
from mlsroad_pipeline.datasets.survey_parameters import LabelParameters, SurveyParameters
from mlsroad_pipeline.datasets.survey_plan import plan_comparison, plan_labelling

CONF = REPOSITORY / "conf"
ENVIRONMENTS = sorted(path.name for path in CONF.iterdir() if path.is_dir() and path.name != "local")
TYPED = {
    "bottom_up_top_down": BottomUpTopDownParameters,
    "hough_forest": HoughForestParameters,
    "object_matching": ObjectMatchingParameters,
    "detection": DetectionParameters,
    "segmentation": SegmentationParameters,
    "recognition": RecognitionParameters,
    "jointnet": JointNetParameters,
    "jointnet_printed": JointNetParameters,
    "spin_image": DescriptorParameters,
    "shot": DescriptorParameters,
    "hierarchy_descriptor": DescriptorParameters,
    "pointnet": PointNetParameters,
    "visual_words": VisualWordsParameters,
    "detrended_forest": ForestParameters,
    "features": FeatureParameters,
    "fusion": FusionParameters,
    "ground_removal": GroundParameters,
    "image_labels": ImageLabelsParameters,
    "ingest": IngestParameters,
    "inspect": InspectParameters,
    "label": LabelParameters,
    "luo2016_study": StudyParameters,
    "luo2019_study": Luo2019StudyParameters,
    "simulated_objects": SimulatedObjectsParameters,
    "tomic2019_study": Tomic2019StudyParameters,
    "yu2016_study": Yu2016StudyParameters,
    "max_margin_markov": MarginParameters,
    "patch_forest": PatchForestParameters,
    "patch_graph": PatchGraphParameters,
    "patch_graph_mrf": GridParameters,
    "patch_svm": PatchSvmParameters,
    "patches": PatchParameters,
    "shape_based": ShapeParameters,
    "supervoxelise": SupervoxelParameters,
    "survey": SurveyParameters,
}
CONFIGURED = {
    "jointnet_printed", "luo2016_study", "luo2019_study", "simulated_objects", "survey", "tomic2019_study",
    "yu2016_study",
}  # fmt: skip
"""Groups whose values are those of the embedded survey or of a paper and not the defaults of the code."""
TREES = {"classes", "simulation"}
"""Groups that are read by functions of their own."""


def base(group):
    return yaml.safe_load((CONF / f"base/parameters_{group}.yml").read_text(encoding="utf-8"))[group]


def default_of(field):
    if field.default is not dataclasses.MISSING:
        return field.default
    if field.default_factory is not dataclasses.MISSING:
        made = field.default_factory()
        return dataclasses.asdict(made) if dataclasses.is_dataclass(made) else made
    return dataclasses.MISSING


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    return make_project(tmp_path_factory.mktemp("conf"), tiny=False)


@pytest.fixture(autouse=True)
def _some_data(monkeypatch, tmp_path):
    monkeypatch.setenv("MLSROAD_DATA", str(tmp_path))


def context_of(project, env, **parameters):
    with session_of(project, env=None if env == "base" else env, **parameters) as session:
        return session.load_context()


def parameters_of(project, env="base", **parameters):
    return context_of(project, env, **parameters).params


def test_every_group_of_parameters_is_known_here():
    groups = {path.stem.removeprefix("parameters_") for path in (CONF / "base").glob("parameters_*.yml")}
    assert groups == set(TYPED) | TREES


@pytest.mark.parametrize("group", TYPED)
def test_keys_are_the_fields_of_the_dataclass(group):
    assert list(base(group)) == [field.name for field in dataclasses.fields(TYPED[group])] or set(base(group)) == {
        field.name for field in dataclasses.fields(TYPED[group])
    }


def as_yaml(value):
    """Turn tuples into lists, nested ones too: YAML knows lists alone."""
    if isinstance(value, (list, tuple)):
        return [as_yaml(entry) for entry in value]
    return {key: as_yaml(entry) for key, entry in value.items()} if isinstance(value, dict) else value


@pytest.mark.parametrize("group", sorted(set(TYPED) - CONFIGURED))
def test_values_are_the_defaults_of_the_code(group):
    for field in dataclasses.fields(TYPED[group]):
        default = default_of(field)
        if default is not dataclasses.MISSING:
            assert base(group)[field.name] == as_yaml(default), field.name


@pytest.mark.parametrize(
    "kind", [*TYPED.values(), OutlierParameters, PoolParameters, TrainingParameters], ids=lambda kind: kind.__name__
)
def test_documented_defaults_are_the_defaults_of_the_code(kind):
    fields = {field.name: default_of(field) for field in dataclasses.fields(kind)}
    documented = {name: entry.type for entry in ClassDoc(kind)["Parameters"] for name in entry.name.split(", ")}
    assert set(documented) == set(fields)
    for name, text in documented.items():
        told = re.search(r"default (.+)$", text)
        if told:
            assert ast.literal_eval(told[1]) == fields[name], name
        elif "optional" in text:
            none_or_said_in_words = ("evaluation_scheme", "folds", "model", "source", "sydney", "trajectory")
            assert name in none_or_said_in_words, name
        else:
            assert fields[name] is dataclasses.MISSING or isinstance(fields[name], dict), name


def leaves(tree, path=()):
    for key, value in tree.items():
        if isinstance(value, dict):
            yield from leaves(value, (*path, key))
        else:
            yield (*path, key), value


@pytest.mark.parametrize("name", ["quick", "tiny"])
def test_smaller_scales_change_parameters_that_there_are(name):
    configured = yaml.safe_load((CONF / f"{name}.yml").read_text(encoding="utf-8"))
    changes = configured["run"]["params"] if name == "quick" else configured
    for path, value in leaves(changes):
        there = base(path[0])
        for key in path[1:]:
            known = isinstance(there, dict) and key in there
            assert known or "surveys" in path, path  # a survey takes any parameter of the simulator
            there = there[key] if known else None
        assert name == "tiny" or value != there, (path, "is the base's own")


def test_make_run_runs_every_method_at_the_quick_scale(project):
    configured = yaml.safe_load((CONF / "quick.yml").read_text(encoding="utf-8"))["run"]
    assert "kedro run --config=conf/quick.yml" in (REPOSITORY / "Makefile").read_text(encoding="utf-8")
    parameters = parameters_of(project, **configured["params"])
    assert pipelines[configured["pipelines"]].nodes
    assert parameters["image_labels"].network.n_steps == configured["params"]["image_labels"]["network"]["n_steps"]
    assert parameters["detrended_forest"].n_trees == base("detrended_forest")["n_trees"]
    assert parameters["jointnet"].training.epochs < base("jointnet")["training"]["epochs"]


@pytest.mark.parametrize("env", ENVIRONMENTS)
def test_every_dataset_of_every_pipeline_can_be_made(project, env):
    context = context_of(project, env)
    catalog, names = context.catalog, set()
    for name in pipelines:
        names |= pipelines[name].datasets() if pipelines[name] else set()
    assert len(names) > 30
    for name in sorted(names):
        assert catalog.get(name) is not None, name
        if name.startswith("params:"):
            catalog.load(name)
    # what stages exchange is stored, so that a run can be resumed; only plans, and what merely joins
    # stored scenes, stay in memory
    in_memory = {n for n in names if type(catalog.get(n)).__name__ == "MemoryDataset" and not n.startswith("params:")}
    plans = {"survey_plan", "label_plan", "luo2016_study.plan", "luo2019_study.plan", "tomic2019_study.plan",
             "yu2016_study.plan"}  # fmt: skip
    assert in_memory == {*plans, "image_labels.drives", "label_images", "patch_training"}


def paths_below_data(env, catalog):
    for name in ("scenes", "detrended_forest.labels", "detrended_forest.scores", "comparison", "label_results_store"):
        described = catalog.get(name)._describe()["filepath"]
        yield re.search(r"data/\d\d_\w+/(\w+)", str(described))[1]


@pytest.mark.parametrize("env", ENVIRONMENTS)
def test_environments_keep_their_data_apart(project, env):
    folders = set(paths_below_data(env, context_of(project, env).catalog))
    assert (folders == {env}) if env != "base" else (env not in folders)


@pytest.mark.parametrize("env", ENVIRONMENTS)
def test_schemes_cover_what_the_coding_can_give_and_nest(project, env):
    parameters = parameters_of(project, env)
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


@pytest.mark.parametrize("name", ["tomic2019", "road_inventory", "luo2016", "asprs"])
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


def from_command_line(text):
    """Nest what `--params=` takes as Kedro does."""
    return _split_params(None, None, text)


def test_command_line_changes_the_survey(project, tmp_path):
    given = from_command_line("survey.root=2019,survey.splits.train=a/*,survey.splits.test=b/*")
    for name in ("a", "b"):
        (tmp_path / "2019" / name).mkdir(parents=True)
        (tmp_path / "2019" / name / "x.las").touch()
    parameters = parameters_of(project, **given)
    survey = dataclasses.replace(parameters["survey"], root=tmp_path / str(parameters["survey"].root))
    plan = plan_comparison(survey, parameters["ingest"], parameters["classes"]["codings"])
    assert [(file.split, file.source.name) for file in plan.files] == [("train", "a/x.las"), ("test", "b/x.las")]


@pytest.mark.parametrize("value", ["a.las", ["a.las"], {"files": ["a.las"], "along": [0, 0.5]}])
def test_split_of_the_base_can_be_a_string_a_list_or_a_mapping(project, value):
    parameters = parameters_of(project, survey={"splits": {"train": value}})
    assert parameters["survey"].splits == {**base("survey")["splits"], "train": value}


def test_split_of_the_base_can_be_left_out(project, tmp_path):
    given = {"survey": {"root": str(tmp_path), "splits": {"train": "*.las", "test": None}}}
    (tmp_path / "x.las").touch()
    parameters = parameters_of(project, **given)
    plan = plan_comparison(parameters["survey"], parameters["ingest"], parameters["classes"]["codings"])
    assert [file.split for file in plan.files] == ["train"]


def test_command_line_changes_execution_of_every_store(project):
    given = from_command_line("execution.backend=threading,execution.n_workers=3")
    catalog = context_of(project, "base", **given).catalog
    for name in ("scenes", "ground", "detrended_forest.labels", "label_results_store", "simulated_surveys"):
        execution = catalog.get(name)._describe()["execution"]
        assert (execution.backend, execution.n_workers) == ("threading", 3), name


def test_command_line_says_where_results_of_label_go(project, tmp_path):
    given = from_command_line(f"label.survey=12,label.output={tmp_path / 'out'},label.model=3,label.method=other")
    context = context_of(project, "base", **given)
    catalog, parameters = context.catalog, context.params["label"]
    assert Path(catalog.get("label_inventory")._describe()["filepath"]) == tmp_path / "out" / "inventory.gpkg"
    table = catalog.get("label_inventory_table")._describe()["filepath"]
    assert Path(table) == tmp_path / "out" / "inventory.parquet"
    assert str(tmp_path / "out" / "report.html") in str(catalog.get("label_report")._describe())
    assert catalog.get("label_registered_model")._describe() == {"name": "mlsroad-other", "model_version": 3}
    assert parameters.model == 3
    with pytest.raises(Exception, match="12 does not exist"):
        plan_labelling(parameters, IngestParameters())


def test_environment_says_where_results_of_label_go_and_the_command_line_overrules_it(tmp_path):
    project = make_project(tmp_path / "project", tiny=False)
    own = {"label": {"output": str(tmp_path / "out"), "method": "other", "model": 4}}
    (project / "conf/local/parameters_label.yml").write_text(yaml.safe_dump(own), encoding="utf-8")
    catalog = context_of(project, "local").catalog
    assert Path(catalog.get("label_inventory")._describe()["filepath"]) == tmp_path / "out/inventory.gpkg"
    assert str(tmp_path / "out/report.html") in str(catalog.get("label_report")._describe())
    assert catalog.get("label_registered_model")._describe() == {"name": "mlsroad-other", "model_version": 4}
    overruled = context_of(project, "local", label={"output": str(tmp_path / "here")}).catalog
    assert Path(overruled.get("label_inventory")._describe()["filepath"]) == tmp_path / "here/inventory.gpkg"
    assert overruled.get("label_registered_model")._describe()["name"] == "mlsroad-other"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("supervoxelise.voxel_sise=0.1", "voxel_sise"),
        ("supervoxelise.voxel_size=0", "supervoxelise.voxel_size must be a finite number > 0, got 0"),
        ("supervoxelise.distance=far", "distance.*'far'"),
        ("ingest.cut=across", "ingest.cut must be 'along' or 'file', got 'across'"),
        ("detrended_forest.n_trees=0", "n_trees must be at least 1, got 0"),
        ("features.region=mine", "region.*mine"),
        ("features.column_size=-1", "column_size.*-1"),
        ("label.model=best", "label.model must be a version"),
        ("ingest.outliers.k=0", "outliers.k must be at least 1, got 0"),
        ("ground_removal.voxel_size=wide", "voxel_size.*'wide'"),
    ],
)
def test_wrong_parameters_are_named_before_anything_runs(project, text, message):
    with pytest.raises(Exception) as caught:  # Kedro wraps them in errors of its own
        assert parameters_of(project, **from_command_line(text))
    assert re.search(message, last_line(caught.value)), last_line(caught.value)


def test_wrong_execution_is_named_before_anything_runs(project):
    given = from_command_line("execution.n_workers=0")
    with pytest.raises(DatasetError, match="n_workers must be a whole number > 0 or null, got 0"):
        context_of(project, "base", **given).catalog.get("scenes")


def test_environments_inherit_what_they_do_not_change(project):
    changed = parameters_of(project, "oakland")
    plain = parameters_of(project)
    assert changed["survey"].scheme == "oakland5" and changed["ingest"].cut == "file"
    assert changed["ingest"] == dataclasses.replace(plain["ingest"], cut="file")
    assert changed["survey"].splits["train"] == "*_a[cehjkm].xyz_label_conf.gz"
    assert joined(changed["simulation"], {"enabled": True}) == plain["simulation"]


def test_label_uses_the_models_of_the_comparison_in_every_environment(project):
    for env in ENVIRONMENTS:
        catalog = context_of(project, env).catalog
        registered = catalog.get("detrended_forest.registered_model")._describe()["name"]
        assert catalog.get("label_registered_model")._describe()["name"] == registered


def test_unknown_coding_is_named():
    survey = SurveyParameters(root="x", splits={}, scheme="s", coding="martian")
    with pytest.raises(ParameterError, match=r"'martian' is not configured \(codings: taxonomy, oakland"):
        survey.options(base("classes")["codings"])

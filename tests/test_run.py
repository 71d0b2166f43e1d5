"""The whole comparison on two tiny surveys, checked against slow recounts of its files."""

import json
import os
import shutil
import subprocess
import sys
import textwrap
from pathlib import Path

import laspy
import mlflow
import numpy as np
import pandas as pd
import pytest
from helpers.wiring import REPOSITORY, TINY, run, session_of, shared_run, stage_counts, tracked_runs
from helpers.yaml_files import read_yaml

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY, ClassScheme
from mlsroad_pipeline.algorithms.metrics.scores import COLUMNS
from mlsroad_pipeline.algorithms.models.methods import methods_of, trained_methods
from mlsroad_pipeline.hooks.run_details import fingerprint_files

pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]

METHOD = "detrended_forest"
GROUND = range(TAXONOMY["road"], TAXONOMY["other_ground"] + 1)


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    return shared_run(tmp_path_factory)


@pytest.fixture(scope="module")
def catalog(project):
    """Load a dataset of the run."""
    with session_of(project, **TINY) as session:
        found = session.load_context().catalog
        yield {name: found.load(name) for name in ("scenes", "ground", f"{METHOD}.labels", "survey_quality")}


def scheme_of(name):
    configured = read_yaml(REPOSITORY / "conf/base/parameters_classes.yml")
    return ClassScheme.from_config(name, configured["classes"]["schemes"][name])


def reporting(project, name):
    return project / "data" / "08_reporting" / name


def split_of(key):
    return key.partition(".")[0]


def test_every_point_of_the_files_is_in_the_core_of_one_scene_as_the_file_has_it(project, catalog):
    for split in ("train", "test"):
        las = laspy.read(project / "data/01_raw/simulated" / split / "survey.laz")
        scenes = [catalog["scenes"][key].load() for key in catalog["scenes"] if split_of(key) == split]
        rows = np.concatenate([scene["row"][scene["core"]] for scene in scenes])
        assert np.array_equal(np.sort(rows), np.arange(len(las.points)))
        for scene in scenes:
            mine = scene["row"]
            assert np.abs(scene.world_xyz() - las.xyz[mine]).max() < 1e-5  # float32 in a scene of tens of metres
            assert np.array_equal(scene["gps_time"], las.gps_time[mine])
            assert np.array_equal(scene["rgb"][:, 1], (las.green[mine] >> 8).astype(np.uint8))


def test_scores_are_those_of_a_recount_of_all_core_points(project, catalog):
    table = pd.read_csv(reporting(project, f"scores/{METHOD}.csv"))
    assert tuple(table.columns) == COLUMNS
    assert set(table["method"]) == {METHOD} and set(table["split"]) == {"test"}
    trained, scored = scheme_of("road_inventory"), scheme_of("tomic2019")
    name_of = {TAXONOMY[member]: c for c, group in zip(scored.classes, scored.members, strict=True) for member in group}
    nested = [name_of[TAXONOMY[group[0]]] for group in trained.members]
    pairs = []
    for key, handle in catalog[f"{METHOD}.labels"].items():
        scene, labels = catalog["scenes"][key].load(), handle.load()["label"]
        core = scene["core"]
        pairs += [(name_of.get(t), nested[p]) for t, p in zip(scene["label"][core], labels[core], strict=True)]
    truth, predicted = np.array([pair for pair in pairs if pair[0] is not None]).T
    value = table.set_index(["class", "metric"])["value"]
    support = table.set_index(["class", "metric"])["support"]
    assert value["all", "overall_accuracy"] == pytest.approx((truth == predicted).mean(), abs=1e-12)
    assert support["all", "overall_accuracy"] == len(truth)
    f1 = []
    for name in scored.classes:
        right = ((truth == name) & (predicted == name)).sum()
        both = (truth == name).sum() + (predicted == name).sum()
        assert support[name, "recall"] == (truth == name).sum()
        if (truth == name).any():
            f1.append(2 * right / both)
            assert value[name, "recall"] == pytest.approx(right / (truth == name).sum(), abs=1e-12)
            assert value[name, "f1"] == pytest.approx(f1[-1], abs=1e-12)
        else:
            assert np.isnan(value[name, "recall"])
    assert value["all", "mean_f1"] == pytest.approx(np.mean(f1), abs=1e-12)


def test_ground_scores_are_those_of_a_recount(project, catalog):
    table = pd.read_csv(reporting(project, "ground_scores.csv")).set_index("split")
    truth, found = [], []
    for key in (key for key in catalog["scenes"] if split_of(key) == "test"):
        scene, ground = catalog["scenes"][key].load(), catalog["ground"][key].load()["ground"]
        keep = scene["core"] & ~np.isin(scene["label"], [TAXONOMY["unlabelled"], TAXONOMY["outlier"]])
        truth.append(np.isin(scene["label"][keep], list(GROUND)))
        found.append(ground[keep])
    truth, found = np.concatenate(truth), np.concatenate(found)
    assert table.loc["test", "type_1"] == pytest.approx((~found[truth]).mean())
    assert table.loc["test", "type_2"] == pytest.approx(found[~truth].mean())
    assert table.loc["test", "total"] == pytest.approx((truth != found).mean())
    assert table.loc["test", "total"] < 0.05  # the filter works on what the simulator makes


def test_supervoxel_quality_is_between_nought_and_one_for_both_splits(project):
    table = pd.read_csv(reporting(project, "supervoxel_quality.csv")).set_index("split")
    assert set(table.index) == {"train", "test"}
    scores = table[["boundary_recall", "under_segmentation_error", "accuracy_ceiling"]]
    assert ((scores > 0) & (scores < 1)).all(axis=None)
    assert (table["accuracy_ceiling"] > 0.9).all()


def test_quality_names_each_file_with_its_points_and_classes(project, catalog):
    table = pd.read_csv(reporting(project, "survey_quality.csv")).set_index("source")
    assert list(table.index) == ["train/survey.laz", "test/survey.laz"]
    for name, row in table.iterrows():
        las = laspy.read(project / "data/01_raw/simulated" / name)
        assert row["n_points"] == len(las.points)
        assert row["min_x"] == pytest.approx(las.x.min()) and row["max_z"] == pytest.approx(las.z.max())
        assert row["class_road"] == (np.asarray(las.label) == TAXONOMY["road"]).sum()


def test_comparison_has_one_row_per_method_and_split(project):
    table = pd.read_csv(reporting(project, "comparison.csv"))
    assert table[["method", "split"]].to_numpy().tolist() == [[method, "test"] for method in methods_of("labelling")]
    for row, method in enumerate(methods_of("labelling")):
        scores = pd.read_csv(reporting(project, f"scores/{method}.csv")).set_index(["class", "metric"])["value"]
        for metric in ("overall_accuracy", "kappa", "mean_f1", "mean_iou"):
            assert table[metric][row] == pytest.approx(scores["all", metric])


@pytest.mark.parametrize(
    ("name", "methods"),
    [
        ("detection_comparison", methods_of("detection")),
        ("recognition_comparison", methods_of("recognition")),
        ("image_comparison", ("image_labels", "fusion", "fusion_pool", "detrended_forest")),
    ],
)
def test_every_task_has_a_table_and_every_method_its_model(project, name, methods):
    table = pd.read_csv(reporting(project, f"{name}.csv"))
    assert set(table["method"]) == set(methods)
    page = reporting(project, "report.html").read_text(encoding="utf-8")
    with session_of(project):
        mlflow.set_tracking_uri(f"sqlite:///{project / 'mlflow.db'}")
        registered = {model.name for model in mlflow.MlflowClient().search_registered_models(max_results=100)}
    for method in methods:
        if method != "fusion_pool":  # the fusion's second way
            assert f"mlsroad-{method}" in registered and f"{method}: scores per class" in page


def test_report_holds_the_figures_of_the_tables(project):
    page = reporting(project, "report.html").read_text(encoding="utf-8")
    scores = pd.read_csv(reporting(project, "comparison.csv"))
    assert page.startswith("<!DOCTYPE html>") and METHOD in page
    assert f"{scores['mean_f1'][0]:.4g}" in page  # as tables print figures
    assert "survey.laz" in page and page.count("data:image/") >= 4
    assert "http://" not in page.replace("http://www.w3.org", "") and "https://" not in page  # it stands alone


@pytest.mark.parametrize("figure", ["birds_eye", "perspective", "confusion", "bars", "importance", "oob"])
def test_figures_are_pictures_with_something_on_them(project, figure):
    from PIL import Image

    picture = np.asarray(Image.open(reporting(project, f"figures/{METHOD}_{figure}.png")).convert("L"))
    assert min(picture.shape) >= 150 and picture.std() > 5


@pytest.fixture(scope="module")
def client(project):
    return mlflow.MlflowClient(f"sqlite:///{project / 'mlflow.db'}")


def test_the_tracked_run_holds_parameters_data_and_figures_of_stages(project, client):
    runs = tracked_runs(project)
    whole = runs["all_methods"]
    assert whole.info.run_name == "all_methods simulated" and whole.info.status == "FINISHED"
    assert len(whole.data.params) <= 60 and len(whole.data.params["classes.digest"]) == 12
    own = runs["detrended_forest"].data.params
    assert own["detrended_forest.n_trees"] == "10" and len(own) <= 60
    assert len(whole.data.tags["data.fingerprint"]) >= 32 and whole.data.tags["runner"] == "SequentialRunner"
    data = {found.dataset.name: found.dataset.digest for found in whole.inputs.dataset_inputs}
    survey = [project / "data/01_raw/simulated/test/survey.laz"]
    assert data["simulated test"] == fingerprint_files(survey)["digest"] and "simulated train" in data
    for name, stage in (("ground_scores", "ground"), ("segmentation_scores", "segmentation")):
        table = pd.read_csv(reporting(project, f"{name}.csv")).set_index("split")
        logged = {key: value for key, value in whole.data.metrics.items() if key.startswith(f"test/{stage}/")}
        assert logged == {f"test/{stage}/{key}": pytest.approx(value) for key, value in table.loc["test"].items()}
    children = {name for name, run in runs.items() if run.data.tags.get("mlflow.parentRunId") == whole.info.run_id}
    assert children == {*runs} - {"all_methods"}
    assert {run.info.status for run in runs.values()} == {"FINISHED"}
    assert children == {*trained_methods(), "fusion_pool"}


def test_the_run_of_a_method_holds_its_scores_series_and_figures(project, client):
    runs = tracked_runs(project)
    scores = pd.read_csv(reporting(project, f"scores/{METHOD}.csv")).dropna(subset="value")
    assert len(scores) > 20
    for row in scores.to_dict("records"):
        levels = [row["split"], row["metric"], *([] if row["class"] == "all" else [row["class"]])]
        assert runs[METHOD].data.metrics["/".join(levels)] == pytest.approx(row["value"])
    assert runs[METHOD].data.params["detrended_forest.n_trees"] == "10"
    assert "patch_svm.cv_per_class" not in runs[METHOD].data.params
    assert f"figures/{METHOD}_birds_eye.png" in figures(client, runs[METHOD])
    objective = client.get_metric_history(runs["patch_graph"].info.run_id, "objective")
    assert [metric.step for metric in objective] == list(range(len(objective))) and len(objective) > 1
    assert objective[-1].value < objective[0].value
    assert "figures/patch_graph_objective.png" in figures(client, runs["patch_graph"])


def figures(client, run):
    return {artifact.path for artifact in client.list_artifacts(run.info.run_id, "figures")}


def test_every_registered_model_has_the_metrics_of_its_own_method_and_only_those(project, client):
    runs = tracked_runs(project)
    registered = client.search_registered_models(max_results=100)
    assert {model.name for model in registered} == {f"mlsroad-{method}" for method in trained_methods()}
    for model in registered:
        run = runs[model.name.removeprefix("mlsroad-")]
        (version,) = client.search_model_versions(f"name='{model.name}'")
        assert (version.version, version.run_id) == (1, run.info.run_id)
        logged = client.get_logged_model(version.source.removeprefix("models:/"))
        assert logged.metrics and {metric.run_id for metric in logged.metrics} == {run.info.run_id}
        assert {metric.key for metric in logged.metrics} == set(run.data.metrics)
        assert all(run.data.params[key] == value for key, value in logged.params.items())
        assert "simulated train" in {found.dataset.name for found in run.inputs.dataset_inputs}
        assert client.get_model_version_by_alias(model.name, "challenger").version == 1
        assert "champion" not in client.get_registered_model(model.name).aliases
        assert "Trained on" in version.description and "Scores: test" in version.description


def test_registered_model_labels_a_table_in_a_process_that_knows_only_the_package(project, tmp_path):
    code = """
        import json, sys
        import laspy, mlflow, pandas as pd
        mlflow.set_tracking_uri(sys.argv[1])
        model = mlflow.pyfunc.load_model("models:/mlsroad-detrended_forest/1")
        las = laspy.read(sys.argv[2])
        points = pd.DataFrame(las.xyz[:6000], columns=["x", "y", "z"])
        found = model.predict(points)
        found.to_csv("labels.csv", index=False)
        print(json.dumps([sorted(found.columns), len(found), found["class"].nunique()]))
        print(json.dumps(sorted({name.partition(".")[0] for name in sys.modules} & {"kedro", "open3d"})))
    """
    survey = project / "data/01_raw/simulated/test/survey.laz"
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", textwrap.dedent(code), f"sqlite:///{project / 'mlflow.db'}", survey],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(REPOSITORY / "src")},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-3000:]
    columns, count, n_classes = json.loads(done.stdout.splitlines()[0])
    assert columns == ["class", "confidence", "label"] and count == 6000 and n_classes >= 4
    assert json.loads(done.stdout.splitlines()[1]) == []
    found = pd.read_csv(tmp_path / "labels.csv")
    assert found["confidence"].between(0, 1).all()
    truth = np.asarray(laspy.read(survey).label)[:6000]
    roads = found["class"][np.isin(truth, [TAXONOMY["road"]])]
    assert (roads == "paved ground").mean() > 0.8


def test_second_run_recomputes_no_scene_and_gives_the_same_scores(project, tmp_path, caplog):
    copy = Path(shutil.copytree(project, tmp_path / "copy", ignore=shutil.ignore_patterns("mlartifacts", "done")))
    before = reporting(copy, f"scores/{METHOD}.csv").read_bytes()
    picture = reporting(copy, f"figures/{METHOD}_birds_eye.png").read_bytes()
    several = [
        "score_patch_graph_mrf",
        "score_visual_words",
        "score_hough_forest",
        f"score_{METHOD}",
        f"picture_{METHOD}",
    ]
    with caplog.at_level("INFO", logger="mlsroad_pipeline"):
        run(copy, to_nodes=several, **TINY)  # what trains and draws beside these has no scenes of its own
    counts = stage_counts(caplog.messages)
    assert len(counts) >= 12
    assert {name: computed for name, (computed, _) in counts.items() if computed} == {}
    assert reporting(copy, f"scores/{METHOD}.csv").read_bytes() == before
    assert reporting(copy, f"figures/{METHOD}_birds_eye.png").read_bytes() == picture


def test_detections_are_counted_by_object_and_scored(project):
    table = pd.read_csv(reporting(project, "scores/visual_words.csv"))
    assert set(table["class"]) == {"light pole", "car", "all"} and set(table["split"]) == {"test"}
    value = table.set_index(["class", "metric"])["value"]
    for name in ("light pole", "car"):
        tp, fp, fn = (value[name, metric] for metric in ("tp", "fp", "fn"))
        assert table.set_index(["class", "metric"])["support"][name, "recall"] == tp + fn
        if tp + fn:
            assert value[name, "recall"] == pytest.approx(tp / (tp + fn))
        if tp + fp:
            assert value[name, "precision"] == pytest.approx(tp / (tp + fp))
    segmentation = pd.read_csv(reporting(project, "segmentation_scores.csv")).set_index("split")
    assert segmentation.loc["test", "n_instances"] > 3 and 0 < segmentation.loc["test", "weighted_coverage"] <= 1
    compared = pd.read_csv(reporting(project, "detection_comparison.csv"))
    assert "visual_words" in set(compared["method"])

"""Benchmark of recordings on small files: all protocols, resumed runs and outputs."""

import json

import mlflow
import numpy as np
import pandas as pd
import pytest
from helpers.conf import base
from helpers.wiring import make_project, run, stage_counts

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY
from mlsroad_pipeline.simulation import simulate_survey
from mlsroad_pipeline.simulation.parameters.presets import simulation_parameters

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]

CODES = {
    "road": 40,
    "sidewalk": 48,
    "grass": 72,
    "building": 50,
    "tree": 70,
    "light_pole": 80,
    "traffic_sign": 81,
    "car": 10,
}
"""Codes of SemanticKITTI of some taxonomy classes; all others are unlabelled."""
FIELDS = {"coding": "semantickitti", "scanner": "simulated", "licence": "none"}
SOURCES = {
    "scans": {**FIELDS, "title": "Scans", "files": "scans/*.npz", "classes": ["ground", "building", "vegetation", "vehicle"],
              "test": {"azimuth": 0, "offset": 15}},
    "blocks": {**FIELDS, "title": "Blocks", "files": "blocks/*.npz", "classes": ["ground", "building", "vehicle"],
               "test": {"files": ["b*.npz"]}, "mixed": {"building": ["pole"]}},
}  # fmt: skip
STREETS = {
    **dict.fromkeys(base("recordings_study")["streets"]),
    "tiny": {"preset": "tiny", "seed": 5, "with_images": False},
}


def write_scan(path, cloud, rows):
    label = np.zeros(256, np.uint8)
    for name, code in CODES.items():
        label[TAXONOMY[name]] = code
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savez(path, xyz=cloud.xyz[rows], intensity=cloud["intensity"][rows], label=label[cloud["label"][rows]])


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    folder = make_project(tmp_path_factory.mktemp("recordings"))
    cloud = simulate_survey(simulation_parameters({"preset": "tiny", "seed": 11, "with_images": False})).cloud
    cloud = cloud.select(np.abs(cloud.xyz[:, 0] - 15.0) < 25.0)
    for number in range(2):
        write_scan(folder / f"data/recordings/scans/{number}.npz", cloud, np.arange(len(cloud)) % 2 == number)
    write_scan(folder / "data/recordings/blocks/a.npz", cloud, cloud.xyz[:, 0] < 15)
    write_scan(folder / "data/recordings/blocks/b.npz", cloud, cloud.xyz[:, 0] >= 15)
    return folder


def benchmark(project, **chosen):
    study = {
        "root": str(project / "data/recordings"),
        "sources": SOURCES,
        "streets": STREETS,
        "least_points": 20,
        **chosen,
    }
    run(project, "recordings_study", recordings_study=study, execution={"backend": "sequential"})
    return pd.read_csv(project / "data/08_reporting/recordings_study/benchmark.csv")


@pytest.fixture(scope="module")
def table(project):
    return benchmark(project, method="patch_forest")


def test_every_protocol_is_scored_and_runs_that_saw_a_part_only_on_the_rest(table):
    parts = {key: sorted(rows["part"]) for key, rows in table.groupby(["source", "protocol"])}
    assert parts == {
        (source, protocol): ["test"] if protocol.startswith("own") else ["all", "test"]
        for source in SOURCES
        for protocol in ("simulated", "others", "own", "own_and_simulated")
    }
    assert (table["iou_ground"] > 0.3).all()
    assert table["mean_iou"].between(0.2, 1).all() and table["calibration_error"].between(0, 0.6).all()
    assert (table[["seconds_per_million", "cpu_seconds_per_million", "train_cpu_seconds"]] > 0).all(axis=None)
    assert table.loc[table["source"] == "blocks", "iou_vegetation"].isna().all()  # no class of it


def test_outputs_and_tracked_run_hold_the_same_figures(project, table):
    folder = project / "data/08_reporting/recordings_study"
    rows = json.loads((folder / "benchmark.json").read_text(encoding="utf-8"))["runs"]
    assert [row["mean_iou"] for row in rows] == pytest.approx(table["mean_iou"].tolist())
    text = (folder / "benchmark.md").read_text(encoding="utf-8")
    assert text.count("| patch_forest | others |") == 3  # the overview and both recordings
    assert "Scans" in (folder / "report.html").read_text(encoding="utf-8")
    client = mlflow.MlflowClient(f"sqlite:///{project / 'mlflow.db'}")
    experiment = client.get_experiment_by_name("mlsroad").experiment_id
    found = client.search_runs([experiment], "tags.mlsroad.method = 'patch_forest'")
    assert len(found) == table.groupby(["source", "protocol"]).ngroups == len({run.info.run_name for run in found})
    for run_of in found:
        tags, metrics, params = run_of.data.tags, run_of.data.metrics, run_of.data.params
        assert run_of.info.run_name == f"patch_forest, {tags['mlsroad.protocol']} on {tags['mlsroad.data']}"
        chosen = table["source"].eq(tags["mlsroad.data"]) & table["protocol"].eq(tags["mlsroad.protocol"])
        rows = table[chosen].set_index("part")
        assert metrics["mean_iou"] == pytest.approx(rows["mean_iou"].iloc[0])  # all points, or those of the test part
        assert metrics["iou/building"] == pytest.approx(rows["iou_building"].iloc[0])
        assert ("test/mean_iou" in metrics) == (len(rows) == 2)
        assert params["data"] == tags["mlsroad.data"] and params["protocol"] == tags["mlsroad.protocol"]
        assert len(params) <= 60 and "patch_forest.n_trees" in params
        assert [data.dataset.name for data in run_of.inputs.dataset_inputs] == [tags["mlsroad.data"]]


def test_one_run_alone_computes_nothing_else_and_keeps_the_rest(project, table, caplog):
    caplog.set_level("INFO")
    chosen = {"method": "pool", "source": "scans", "protocol": "shipped"}
    again = benchmark(project, **chosen)
    counts = stage_counts(caplog.messages)
    assert counts == {"scenes": (0, 2), "prepared": (0, 0), "models": (0, 0), "runs": (1, 0)}
    both = again.merge(table, on=["source", "protocol", "method", "part", "mean_iou", "finished"])
    assert len(both) == len(table) and len(again) == len(table) + 2
    page = (project / "data/08_reporting/recordings_study/pictures/scans.html").read_text(encoding="utf-8")
    assert page.count("data:image/") == 2 and "pool, shipped" in page


def test_the_pool_is_scored_with_trees_that_it_shares_with_their_own_runs(project, caplog):
    caplog.set_level("INFO")
    chosen = {"source": "scans", "protocol": "own"}
    pooled = benchmark(project, method="pool", **chosen)
    assert stage_counts(caplog.messages)["models"] == (1, 0)
    caplog.clear()
    both = benchmark(project, method="boosted_trees", **chosen)
    assert stage_counts(caplog.messages)["models"] == (0, 1)
    own = both[(both["source"] == "scans") & (both["protocol"] == "own")]
    rows = own[own["method"].isin(["pool", "boosted_trees"])].set_index("method")
    assert rows["train_cpu_seconds"].nunique() == 1 and rows["mean_iou"].between(0.2, 1).all()
    assert rows["calibration_error"].nunique() == 2 and len(both) == len(pooled) + 1

"""Origin beside tables of scores and in the footers of reports: one small pipeline with the hooks, without MLflow."""

import json

import numpy as np
import pytest
from kedro.framework.hooks.manager import _create_hook_manager
from kedro.io import DataCatalog, MemoryDataset
from kedro.pipeline import Node, Pipeline
from kedro.runner import SequentialRunner

from mlsroad_pipeline.algorithms.metrics.scores import labelling_scores
from mlsroad_pipeline.datasets.report_files import HtmlReportDataset, ScoresDataset
from mlsroad_pipeline.hooks.origin import OriginHooks
from mlsroad_pipeline.hooks.run_details import fingerprint_files
from mlsroad_pipeline.reporting.html.report import build_report


class Source:
    def __init__(self, path):
        self.path = path


class Task:
    def __init__(self, path):
        self.inputs = {"cloud": Source(path)}


def score(tasks, forest):
    return labelling_scores(np.array([[8, 2], [0, 3]]), method="demo", split="test", classes=["road", "car"])


def report(scores):
    return build_report([], title="Comparison")


@pytest.fixture
def made(tmp_path, monkeypatch):
    """Run a pipeline as `kedro run --config=own.yml` does, and return its folder."""
    monkeypatch.setattr("sys.argv", ["/venv/bin/kedro", "run", "--config=own.yml", "--params=forest.seed=7"])
    (tmp_path / "a.laz").write_text("points")
    catalog = DataCatalog(
        {
            "params:path": MemoryDataset(str(tmp_path / "a.laz")),
            "params:forest": MemoryDataset({"seed": 7, "n_trees": 3}),
            "tasks": MemoryDataset(copy_mode="assign"),
            "scores": ScoresDataset(filepath=str(tmp_path / "scores" / "demo.csv")),
            "report": HtmlReportDataset(filepath=str(tmp_path / "report.html")),
        }
    )
    pipeline = Pipeline(
        [
            Node(lambda path: {"test.a.scene_00000": Task(path)}, "params:path", "tasks", name="plan"),
            Node(score, ["tasks", "params:forest"], "scores"),
            Node(report, "scores", "report"),
        ]
    )
    hooks, manager = OriginHooks(), _create_hook_manager()
    manager.register(hooks)
    hooks.before_pipeline_run({"pipeline_names": ["demo"], "project_path": str(tmp_path)}, pipeline, catalog)
    SequentialRunner().run(pipeline, catalog, hook_manager=manager)
    return tmp_path


def test_a_table_of_scores_has_its_origin_beside_it(made):
    origin = json.loads((made / "scores/demo.json").read_text())
    assert set(origin) == {"commit", "dirty", "seed", "command", "parameters", "versions", "data", "date"}
    assert origin["command"] == "kedro run --config=own.yml --params=forest.seed=7"
    assert origin["seed"] == {"forest.seed": "7"}
    assert origin["data"] == fingerprint_files([made / "a.laz"])["digest"]
    assert origin["versions"]["numpy"] == np.__version__ and origin["versions"]["python"].startswith("3.")
    assert origin["commit"] is None and origin["dirty"] is None  # the folder is no repository


def test_a_report_has_the_origin_as_its_footer(made):
    page = (made / "report.html").read_text()
    footer = page[page.index("<footer>") : page.index("</footer>")]
    origin = json.loads((made / "scores/demo.json").read_text())
    for text in (origin["command"], "forest.seed = 7", origin["data"], f"numpy {np.__version__}", origin["date"]):
        assert text in footer

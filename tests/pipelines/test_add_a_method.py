"""A method is a folder and a line of the table: it gets a pipeline, is trained, scored and used by `label`."""

import re
import sys

import laspy
import numpy as np
import pandas as pd
import pytest
from helpers.wiring import REPOSITORY, TINY, copied_stages, label, run, session_of
from kedro.framework.project import pipelines

from mlsroad_pipeline.algorithms.models.methods import METHODS, Method
from mlsroad_pipeline.papers import luo2016

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]

PAGE = (REPOSITORY / "docs/how_to/add_a_method.md").read_text(encoding="utf-8")
FOLDERS = REPOSITORY / "tests/helpers/methods"
"""Folder of the method's folder."""


def line_of_the_page():
    """Return the line that the page adds to the table, for the toy method in place of the example."""
    [block] = [code for code in re.findall(r"```python\n(.*?)```", PAGE, re.S) if code.startswith("Method(")]
    method: Method = eval(block.replace("my_forest", "toy").replace("MyForest", "Toy"), {"Method": Method})
    return method


@pytest.fixture
def project(shared, tmp_path, monkeypatch):
    """A project with the folder, the line and the parameters of the method."""
    monkeypatch.setattr(luo2016, "__path__", [*luo2016.__path__, str(FOLDERS)])
    monkeypatch.setitem(METHODS, "toy", line_of_the_page())
    project = copied_stages(shared, tmp_path / "project")
    (project / "conf/base/parameters_toy.yml").write_text("toy:\n  height: 0.3\n", encoding="utf-8")
    yield project
    for name in [name for name in sys.modules if name.startswith("mlsroad_pipeline.papers.luo2016.toy")]:
        del sys.modules[name]


def test_a_method_of_one_line_is_trained_scored_and_used(project, tmp_path):
    run(project, to_nodes=["score_toy"], **TINY)
    names = {node.name for node in pipelines["toy"].nodes}
    assert names == {"labelling.gather_patch_training", "labelling.toy.train_toy", "labelling.toy.label_by_toy"}
    assert "compare_methods" in {node.name.rpartition(".")[2] for node in pipelines["__default__"].nodes}
    scores = pd.read_csv(project / "data/08_reporting/scores/toy.csv").set_index(["split", "class", "metric"])["value"]
    assert scores["test", "all", "overall_accuracy"] > 0.5
    with session_of(project, **TINY) as session:
        bundle = session.load_context().catalog.load("toy.registered_model")
    assert bundle.slug == "toy"
    assert bundle.metadata["parameters"]["toy"] == {"height": 0.3}
    [survey] = (project / "data/01_raw").rglob("test/*.laz")
    output = label(project, survey, tmp_path / "labelled", method="toy")
    labelled = laspy.read(output / survey.name)
    assert len(np.unique(labelled.classification)) >= 2 and labelled.confidence.max() == 1.0

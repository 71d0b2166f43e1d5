"""Labels of recordings that are refined to the classes of the network."""

import numpy as np
import pytest

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY, ClassScheme
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.models.labelling import SoftLabels
from mlsroad_pipeline.algorithms.models.pool import recorded_graphs
from mlsroad_pipeline.algorithms.models.pool.recorded_graphs import refined_labels


def scheme(name, classes, ignore):
    return ClassScheme.from_config(
        name, {"classes": {k: {"members": v, "asprs": 1} for k, v in classes.items()}, "ignore": ignore}
    )


@pytest.fixture
def schemes():
    ignored = [name for name in TAXONOMY if name not in ("road", "grass", "tree", "hedge")]
    fine = scheme("fine", {"paved": ["road"], "natural": ["grass"], "tall": ["tree"], "low": ["hedge"]}, ignored)
    coarse = scheme("coarse", {"ground": ["road", "grass"], "plants": ["tree", "hedge"]}, ignored)
    return fine, coarse


def test_the_most_probable_class_among_those_that_the_label_allows(monkeypatch, schemes):
    fine, coarse = schemes
    probabilities = np.array([[0.1, 0.2, 0.3, 0.4], [0.5, 0.1, 0.3, 0.1]], np.float32)
    owner = np.array([0, 0, 1, 1, -1, 0])
    soft = SoftLabels(np.zeros(6, np.int16), np.ones(6, np.float32), probabilities, owner)

    def softly(bundle, cloud):
        assert "label" not in cloud
        return soft

    monkeypatch.setattr(recorded_graphs, "label_softly", softly)
    names = ["road", "tree", "road", "hedge", "road", "unlabelled"]
    scene = PointCloud(np.zeros((6, 3)), {"label": np.array([TAXONOMY[name] for name in names], np.uint8)})
    codes = refined_labels(scene, ModelBundle("tests", {}, {"classes": ["a"]}), scheme=fine, coarse=coarse)
    found = [next(name for name, code in TAXONOMY.items() if code == value) for value in codes.tolist()]
    assert found == ["grass", "hedge", "road", "tree", "unlabelled", "unlabelled"]

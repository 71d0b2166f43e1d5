"""Pipelines that train files of the package, with tiny streets: the files have the form that `label` loads."""

import numpy as np
import pytest
from helpers.wiring import make_project, run

from mlsroad_pipeline.algorithms.inventory.objects.measured_rows import FEATURES
from mlsroad_pipeline.algorithms.inventory.objects.rules import KINDS
from mlsroad_pipeline.algorithms.inventory.objects.stem_features import STEM_FEATURES
from mlsroad_pipeline.algorithms.models.pool.labeller import INTERCEPT, TERMS
from mlsroad_pipeline.model_store import object_classifiers
from mlsroad_pipeline.model_store.object_classifiers import CARD, CLASSIFIER, REPLAY, read_candidate_replay
from mlsroad_pipeline.model_store.shipped_models import load_shipped, shipped_models

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]

STREETS = {"count": 3, "presets": ["tiny"], "streets": ["residential", "town"], "seed": 1, "length": 20.0}
SHIPPED = {
    "name": "general",
    "classifier_streets": {"s": {**STREETS, "with_images": False}},
    "colour_streets": 2,
    "colour_survey": {"preset": "tiny", "length": 15.0},
}


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    """Folder of the models of a project whose pipelines of shipped models have run."""
    project = make_project(tmp_path_factory.mktemp("shipped"))
    for name in ("ground_colour", "object_classifier"):
        run(project, name, shipped=SHIPPED, execution={"backend": "sequential"})
    return project / "src/mlsroad_pipeline/model_store"


def test_the_object_classifier_is_read_and_scores_candidates(store, monkeypatch):
    folder = store / "shipped_object_classifier"
    monkeypatch.setattr(object_classifiers, "FOLDER", folder)
    with np.load(folder / CLASSIFIER, allow_pickle=False) as arrays:
        classifier = object_classifiers.ObjectClassifier.from_arrays(dict(arrays))
    classifier.check_features("stem", STEM_FEATURES)
    replay = read_candidate_replay(folder / REPLAY)
    assert set(replay) == set(KINDS)
    for kind in KINDS:
        classifier.check_features(kind, FEATURES)
        values, true = replay[kind]
        assert len(values) == len(true)
        probability = classifier.probabilities(kind, values)
        assert ((probability >= 0) & (probability <= 1)).all()
    # The kind with most true and false candidates: few of a tiny street are too few to split.
    kind = max(KINDS, key=lambda name: min(replay[name].true.sum(), (~replay[name].true).sum()))
    score, true = classifier.probabilities(kind, replay[kind].values)[:, 0], replay[kind].true
    assert score[true].mean() > score[~true].mean()
    card = (folder / CARD).read_text(encoding="utf-8")
    assert "Trained on 2 simulated streets of 2 kinds" in card
    assert "`kedro run --env=general --pipelines=object_classifier`" in card and "| as labelled | tree |" in card


def test_the_pool_gets_weights_of_colour(store):
    shipped = load_shipped("pool", store / "shipped")
    assert set(shipped.metadata["ground_colour"]) == {*TERMS, INTERCEPT}
    assert shipped.metadata["ground_colour"] != load_shipped("pool").metadata["ground_colour"]
    assert "rgb" in shipped_models(store / "shipped")["pool"].attributes
    own, package = shipped.arrays, load_shipped("pool").arrays
    assert all(np.array_equal(own[name], package[name]) for name in package)

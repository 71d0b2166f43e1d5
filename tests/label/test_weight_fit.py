"""Weight of predictions, fitted on points with a class."""

from types import SimpleNamespace

import numpy as np
import pytest
from helpers.labelled import scheme as configured_scheme

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.models.given_labels.labeller import PROBABILITIES, given_bundle
from mlsroad_pipeline.algorithms.models.labelling import SoftLabels
from mlsroad_pipeline.label import weight_fit
from mlsroad_pipeline.surveys.given_classes import KEPT, GivenParameters

SCHEME = ClassScheme.from_config("road_inventory", configured_scheme())
N = 600


def noisy(true, right, rng):
    """Return probabilities whose most probable class is the true one for a share of the points."""
    shown = np.where(rng.random(N) < right, true, rng.integers(0, len(SCHEME), N))
    rows = np.full((N, len(SCHEME)), 0.02, np.float32)
    rows[np.arange(N), shown] = 1 - 0.02 * (len(SCHEME) - 1)
    return rows


@pytest.fixture
def fit(monkeypatch):
    def run(of_model, of_predictions, labelled=N):
        rng = np.random.default_rng(2)
        true = rng.integers(0, len(SCHEME), N)
        numbers = np.where(np.arange(N) < labelled, SCHEME.codes()[true], 1)
        scene = PointCloud(
            rng.uniform(0, 30, (N, 3)).astype(np.float32),
            {KEPT: numbers, "core": np.ones(N, bool), PROBABILITIES: noisy(true, of_predictions, rng)},
        )
        own = noisy(true, of_model, rng)
        soft = SoftLabels(own.argmax(1).astype(np.int16), own.max(1), own, np.arange(N, dtype=np.int32))
        settings = SimpleNamespace(outliers=None)
        task = SimpleNamespace(inputs={"pieces": []}, parameters={"settings": settings, "span": None, "source": "a"})
        monkeypatch.setattr(weight_fit, "_pieces", lambda task: [scene])
        monkeypatch.setattr(weight_fit, "_numbers", lambda piece: piece[KEPT])
        monkeypatch.setattr(weight_fit, "join_pieces", lambda pieces, *_: pieces[0])
        monkeypatch.setattr(weight_fit, "labels_of_model", lambda scene, bundle, settings: (scene, {}, soft, None))
        given = GivenParameters.from_config({"labels": "p", "weight": "fit", "classes": "mlsroad"})
        return weight_fit.fitted_weight({"a": task}, given_bundle(SCHEME), given, {})

    return run


def test_the_better_source_has_the_larger_weight(fit):
    better, alike, worse = fit(0.5, 0.95), fit(0.7, 0.7), fit(0.95, 0.5)
    assert better > 0.7 and worse < 0.3
    assert 0.25 < alike < 0.75


def test_a_survey_without_classes_gives_no_weight(fit):
    with pytest.raises(DataError, match=r"weight=fit: 40 points of the survey have a class of mlsroad"):
        fit(0.5, 0.9, labelled=40)


@pytest.mark.parametrize("weight", ["best", 0, 1.5, True])
def test_a_weight_is_a_number_or_fit(weight):
    with pytest.raises(ParameterError, match="must be a number between 0 and 1, or fit"):
        GivenParameters.from_config({"labels": "p", "weight": weight})

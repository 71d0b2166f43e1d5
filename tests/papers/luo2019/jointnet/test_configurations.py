"""Configurations of JointNet: as printed, and tuned where the text leaves a choice."""

import numpy as np
import pytest
from helpers.conf import base

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.papers.luo2019.jointnet.parameters import JointNetParameters, TrainingParameters
from mlsroad_pipeline.papers.luo2019.jointnet.recogniser import JointNetRecogniser

PRINTED = {  # Luo et al. 2019: sections 3.2.1 to 3.2.4, 4.2
    "inputs": {
        "views": ["hssi", "vqai", "vaai"], "sizes": [16, 8, 16], "isotropic": False, "window": None, "bilinear": False,
        "printed_rows": True, "relative": False, "compress": False, "intensity": False, "measures": False,
    },
    "training": {
        "epochs": 150, "copies": 1, "batch_size": 32, "learning_rate": 0.001, "momentum": 0.9, "weight_decay": 0.0005,
        "clip": 0.0, "schedule": "halving", "label_smoothing": 0.0, "loss": "mean", "n_members": 1, "n_turns": 1,
        "validation": 0.0, "regression_share": 0.0,
    },
    "augmentation": {
        "rotate": False, "drop": 0.0, "occlude": 0.0, "noise": 0.0, "scale": 0.0, "outliers": 0.0, "hide_intensity": 0.0,
    },
}  # fmt: skip
TUNED = {
    "inputs": {
        **PRINTED["inputs"], "window": [2.0, 4.0], "bilinear": True, "printed_rows": False, "relative": True,
        "compress": True,
    },
    "training": {
        **PRINTED["training"], "copies": 4, "learning_rate": 0.01, "clip": 1.0, "n_turns": 8,
    },
    "augmentation": {**PRINTED["augmentation"], "rotate": True, "drop": 0.6, "occlude": 0.4, "scale": 0.1},
}  # fmt: skip


@pytest.mark.parametrize(("slug", "wanted"), [("jointnet_printed", PRINTED), ("jointnet_tuned", TUNED)])
def test_both_configurations_have_the_stated_values(slug, wanted):
    given = base(slug)
    assert given["inputs"] == {**wanted["inputs"], "clean": 0.0}
    assert {name: given["training"][name] for name in wanted["training"]} == wanted["training"]
    assert given["training"]["augmentation"] == wanted["augmentation"]
    assert given["network"]["batch_norm"] is False and given["network"]["dropout"] == 0.3  # keeps 0.7
    JointNetParameters(**given)


def test_the_sum_over_a_batch_is_the_mean_at_a_larger_rate(rng):
    objects = [rng.normal(size=(30, 3)) * ([0.1, 0.1, 1] if k % 2 else [1, 1, 0.1]) for k in range(16)]
    classes = np.arange(16) % 2
    plain = {"copies": 1, "epochs": 3, "batch_size": 16, "n_members": 1, "n_turns": 1, "label_smoothing": 0.0}
    still = {"rotate": False, "drop": 0.0, "occlude": 0.0, "scale": 0.0, "hide_intensity": 0.0}
    both = [
        JointNetParameters(
            inputs={"intensity": False, "measures": False}, network={"batch_norm": False, "dropout": 0.0},
            training=TrainingParameters(
                **plain, loss=loss, learning_rate=rate, weight_decay=0.0, schedule="halving", augmentation=still
            ),
        )
        for loss, rate in (("mean", 0.016), ("sum", 0.001))
    ]  # fmt: skip
    one, other = (JointNetRecogniser(p).fit(objects, classes) for p in both)
    np.testing.assert_allclose(one.predict_proba(objects), other.predict_proba(objects), atol=1e-4)
    losses = [[entry["loss"] for entry in found.histories_[0]] for found in (one, other)]
    assert losses[0] == pytest.approx(losses[1], rel=1e-3)


def test_a_training_that_diverges_is_an_error(rng):
    objects = [rng.normal(size=(300, 3)) for _ in range(8)]
    training = {"epochs": 5, "copies": 1, "loss": "sum", "learning_rate": 50.0, "n_members": 1, "label_smoothing": 0.0}
    wild = JointNetParameters(
        inputs={"relative": False, "compress": False, "measures": False},
        network={"batch_norm": False},
        training=training,
    )
    with pytest.raises(DataError, match=r"diverged in epoch \d: lower training\.learning_rate \(50\)"):
        JointNetRecogniser(wild).fit(objects, np.arange(8) % 2)

"""Configurations of JointNet: as printed, and tuned where the text leaves a choice."""

import numpy as np
import pytest
import torch
from helpers.conf import base

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.papers.luo2019.jointnet.network import JointNet
from mlsroad_pipeline.papers.luo2019.jointnet.parameters import JointNetParameters, TrainingParameters
from mlsroad_pipeline.papers.luo2019.jointnet.recogniser import JointNetRecogniser

PRINTED = {  # Luo et al. 2019: sections 3.2.1 to 3.2.4, 4.2
    "inputs": {
        "views": ["hssi", "vqai", "vaai"], "sizes": [16, 8, 16], "isotropic": False, "window": None, "bilinear": False,
        "printed_equations": True, "relative": False, "compress": False, "intensity": False, "measures": False,
    },
    "training": {
        "epochs": 150, "copies": 1, "batch_size": 32, "learning_rate": 0.001, "momentum": 0.9, "weight_decay": 0.0005,
        "clip": 0.0, "schedule": "halving", "label_smoothing": 0.0, "loss": "sum", "n_members": 1, "n_turns": 1,
        "validation": 0.0, "regression_share": 0.0,
    },
    "augmentation": {
        "rotate": False, "drop": 0.0, "occlude": 0.0, "noise": 0.0, "scale": 0.0, "outliers": 0.0, "hide_intensity": 0.0,
    },
}  # fmt: skip
TUNED = {
    "inputs": {
        **PRINTED["inputs"], "window": [2.0, 4.0], "bilinear": True, "printed_equations": False, "relative": True,
        "compress": True,
    },
    "training": {
        **PRINTED["training"], "copies": 4, "learning_rate": 0.01, "clip": 1.0, "n_turns": 8, "loss": "mean",
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
    assert given["network"]["initialisation"] == ("glorot" if slug == "jointnet_printed" else "he")
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


def test_sub_networks_of_section_4_3_have_no_fusion_module(rng):
    parameters = JointNetParameters(
        inputs={"views": ["hssi"], "intensity": False, "measures": False}, network={"fusion": False, "dropout": 0.0}
    )
    network = JointNet(parameters, 9).eval()
    assert [name for name, _ in network.fusion_1.named_parameters()] == []
    assert {name: tuple(p.shape) for name, p in network.fusion_2.named_parameters()} == {
        "hssi.scores.weight": (9, 5 * 4 * 8 * 8), "hssi.scores.bias": (9,),
    }  # fmt: skip
    images = torch.from_numpy(rng.random((3, 5, 1, 16, 16), dtype=np.float32))
    values = network.convolutional(images.flatten(0, 1)).reshape(3, -1)
    scores = network({"hssi": images}, torch.zeros(3, 0))
    torch.testing.assert_close(scores[0], network.fusion_2["hssi"].scores(values))


@pytest.mark.parametrize(("initialisation", "variance"), [("glorot", 2 / (6000 + 64)), ("he", 2 / 6000)])
def test_initial_weights_have_the_spread_of_their_source(initialisation, variance):
    """Glorot and Bengio 2010, equation 16, as TensorFlow's default; He et al. 2015, equation 10."""
    network = JointNet(
        JointNetParameters(
            inputs={"intensity": False, "measures": False},
            network={"initialisation": initialisation, "convolutional_widths": [8, 16, 16, 16, 2000]},
        ),
        9,
    )
    weights = network.convolutional[-5].weight  # from 3 x 2,000 values to 64
    assert weights.shape == (64, 6000)
    assert weights.var().item() == pytest.approx(variance, rel=0.02)
    with pytest.raises(ParameterError, match="network.initialisation must be he or glorot, got 'lecun'"):
        JointNetParameters(network={"initialisation": "lecun"})

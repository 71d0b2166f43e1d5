"""Models that learn from corrections (boosted trees, pools, other labellers), and their storage."""

import hashlib
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.stage_parameters import GroundParameters
from mlsroad_pipeline.algorithms.models.boosted_trees.answer_boosting import Answer, Replay, Scored
from mlsroad_pipeline.algorithms.models.boosted_trees.corrected import (
    FLOOR,
    added_trees,
    continue_training,
    labeller_of,
    learn_corrections,
    voxel_scores,
)
from mlsroad_pipeline.algorithms.models.boosted_trees.labeller import parameters_of, softmax
from mlsroad_pipeline.algorithms.models.boosted_trees.parameters import SLUG
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.models.machines.boosted_trees import BoostedTrees
from mlsroad_pipeline.algorithms.models.machines.combinations import decide
from mlsroad_pipeline.algorithms.models.pool.labeller import SLUG as POOL
from mlsroad_pipeline.algorithms.models.pool.labeller import TREES, members_of, with_trees
from mlsroad_pipeline.model_store.bundle_files import save_bundle
from mlsroad_pipeline.model_store.object_classifiers import read_replay
from mlsroad_pipeline.model_store.registered_models import PREFIX
from mlsroad_pipeline.model_store.shipped_models import load_shipped
from mlsroad_pipeline.review.corrections.object_answers import Tile

GENERAL = "general"
"""Shipped trees whose thresholds, and whose training voxels, other labellers learn with."""


def _mean_scores(bundle: ModelBundle, tile: Tile) -> NDArray[np.float64]:
    described = tile.scene.with_columns(ground=tile.ground, height=tile.height)
    return voxel_scores(bundle, described, tile.voxels.owner, len(tile.voxels.values))


def _log_probabilities(trees: ModelBundle, values: NDArray[np.float32]) -> NDArray[np.float64]:
    """Return the logarithms of the probabilities of boosted trees, as a pool uses them."""
    raw = BoostedTrees.from_arrays(trees.arrays).scores(values) / trees.arrays["temperature"] + trees.arrays["offsets"]
    return np.log(np.maximum(softmax(raw), FLOOR))


class TreeLearner:
    """Boosted trees, alone or in a pool: their own boosting goes on."""

    def __init__(self, bundle: ModelBundle) -> None:
        self._bundle = bundle
        self._trees = members_of(bundle)[TREES] if bundle.slug == POOL else bundle
        self._replay = read_replay(self._trees)
        self.ground = GroundParameters(**self._trees.metadata["parameters"]["ground"])
        self.voxel_size = parameters_of(self._trees).voxel_size

    def scores(self, tile: Tile) -> NDArray[np.float64]:
        """Return the scores of the trees, or those of the pool; the training computes its own from the features."""
        if self._bundle.slug != POOL:
            return _log_probabilities(self._trees, tile.voxels.values)
        return _mean_scores(self._bundle, tile)

    def change(self, model: ModelBundle, values: NDArray[np.float32]) -> NDArray[np.float64]:
        """Return the difference of the trees' scores, with the weight of the trees."""
        is_pool = self._bundle.slug == POOL
        trees = members_of(model)[TREES] if is_pool else model
        weight = float(model.metadata["weights"][TREES]) if is_pool else 1.0
        return weight * (_log_probabilities(trees, values) - _log_probabilities(self._trees, values))

    def decided(self, scores: NDArray[np.float64]) -> tuple[NDArray[np.int16], NDArray[np.float32]]:
        """Return the class of voxels, and its probability."""
        return decide(softmax(scores), self._trees.arrays.get("groups"))

    def learned(self, answers: Sequence[Answer], survey: Scored, *, learned_from: Mapping[str, Any]) -> ModelBundle:
        """Return the trees with further ones; in a pool, the pool with them."""
        trees = continue_training(self._trees, answers, survey.values, self._replay, learned_from=learned_from)
        return with_trees(self._bundle, trees) if self._bundle.slug == POOL else trees


class CorrectedLearner:
    """Any other labeller: boosted trees are added that correct its probabilities."""

    def __init__(self, bundle: ModelBundle, general: ModelBundle) -> None:
        self._bundle, self._general = bundle, general
        self._trees = BoostedTrees.from_arrays(general.arrays)
        self.ground = GroundParameters(**labeller_of(bundle).metadata.get("parameters", {}).get("ground", {}))
        self.voxel_size = parameters_of(general).voxel_size

    def scores(self, tile: Tile) -> NDArray[np.float64]:
        """Return the logarithms of the labeller's mean probabilities in each voxel."""
        return _mean_scores(self._bundle, tile)

    def change(self, model: ModelBundle, values: NDArray[np.float32]) -> NDArray[np.float64]:
        """Return the scores of the trees that were added."""
        after, before = added_trees(model), added_trees(self._bundle)
        gained = np.zeros((len(values), len(model.classes))) if after is None else after.scores(values)
        return gained if before is None else gained - before.scores(values)

    def decided(self, scores: NDArray[np.float64]) -> tuple[NDArray[np.int16], NDArray[np.float32]]:
        """Return the class of voxels, and its probability."""
        return decide(softmax(scores), labeller_of(self._bundle).arrays.get("groups"))

    def learned(self, answers: Sequence[Answer], survey: Scored, *, learned_from: Mapping[str, Any]) -> ModelBundle:
        """Return the labeller with trees that correct it."""
        replay, size = self._replayed(), self.voxel_size
        return learn_corrections(
            self._bundle, answers, survey, replay, trees=self._trees, voxel_size=size, learned_from=learned_from
        )

    def _replayed(self) -> tuple[Replay, Scored]:
        """Return the training voxels of the shipped trees with their scores; none for a model with other classes.

        The labeller's scores of these voxels are unknown, because their points are not kept.
        """
        classes = self._bundle.metadata["classes"]
        if list(classes) != list(self._general.metadata["classes"]):
            none = np.zeros((0, self._trees.n_features), np.float32)
            return Replay(none, np.zeros((0, len(classes)), np.bool_)), Scored(none, np.zeros((0, len(classes))))
        replay = read_replay(self._general)
        values = replay.values.astype(np.float32)
        arrays = self._general.arrays
        return replay, Scored(values, self._trees.scores(values) / arrays["temperature"] + arrays["offsets"])


Learner = TreeLearner | CorrectedLearner
"""A model that learns: ground filter and edge of the voxels of its tiles, their scores, and the training."""


def learner_of(bundle: ModelBundle) -> Learner:
    """Return a model as one that learns; trees continue where their training voxels are at hand."""
    general = load_shipped(GENERAL)
    has_replay = list(bundle.metadata["classes"]) == list(general.metadata["classes"])
    return TreeLearner(bundle) if bundle.slug in (SLUG, POOL) and has_replay else CorrectedLearner(bundle, general)


MODELS = "models"
"""Folder in an output that holds learned models where no MLflow store is configured."""


def write_learned(model: ModelBundle, output: Path) -> tuple[str, dict[str, str]]:
    """Write a model into an output folder; return its path, and the parameters of `label` that choose it."""
    digest = hashlib.blake2b(digest_size=4)
    for name in sorted(model.arrays):
        digest.update(np.ascontiguousarray(model.arrays[name]).tobytes())
    folder = (output / MODELS / f"{model.slug}-{digest.hexdigest()}").absolute()
    save_bundle(model, folder)
    return str(folder), {"model": str(folder)}


def register_learned(model: ModelBundle, parent: Mapping[str, Any], store: str) -> tuple[str, dict[str, str]]:
    """Register a model with the tag ``parent``; return its name, and the parameters of `label` that choose it."""
    os.environ.setdefault("MLFLOW_ENABLE_ARTIFACTS_PROGRESS_BAR", "false")  # it would draw bars for files of a few kB
    import mlflow  # noqa: PLC0415  few runs are tracked

    from mlsroad_pipeline.model_store.registration import register_bundle  # noqa: PLC0415

    mlflow.set_tracking_uri(store)
    name = f"{PREFIX}{model.slug}"
    version, _ = register_bundle(model, name)
    client = mlflow.MlflowClient()
    tags = {"parent": f"{parent['name']} {parent['version']}".strip(), "trained_on": str(model.metadata["trained_on"])}
    for tag, text in tags.items():
        client.set_model_version_tag(name, str(version), tag, text)
    return f"{name} version {version}", {"method": model.slug, "model": str(version)}

"""What the pipelines of the methods that label patches share: the training scenes, and labels of the other scenes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from joblib import cpu_count
from kedro.pipeline import Node, Pipeline

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.evaluation.labelling import find_scheme
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.patches.extraction import PatchParameters
from mlsroad_pipeline.algorithms.patches.labelling import PatchClassifier, PatchStages
from mlsroad_pipeline.algorithms.patches.training import PatchTraining, join_training_scenes, number_surveys
from mlsroad_pipeline.algorithms.stages import GroundParameters
from mlsroad_pipeline.datasets.scene_store_dataset import SceneCollection
from mlsroad_pipeline.execution.task import SceneTask, SourceFile, scene_tasks
from mlsroad_pipeline.pipelines.method_work import label_prepared_patches
from mlsroad_pipeline.surveys.parameters import SurveyParameters
from mlsroad_pipeline.surveys.plan import held_out_keys


@dataclass(frozen=True, eq=False)
class TrainingScenes:
    """The training scenes in their stores, and what a model says of them.

    Attributes
    ----------
    patches, labels : SceneCollection
        Patches of all scenes, and the classes of those of the training scenes.
    stages : PatchStages
        How the scenes were prepared.
    scheme : ClassScheme
        The classes.
    trained_on : mapping
        What a model's metadata say of the training data.
    """

    patches: SceneCollection
    labels: SceneCollection
    stages: PatchStages
    scheme: ClassScheme
    trained_on: Mapping[str, Any]

    def load(self) -> PatchTraining:
        """Read the patches of all training scenes."""
        joined = join_training_scenes({key: self.patches[key].load() for key in self.labels}, self.labels.load_all())
        return PatchTraining(*joined, self.stages, self.scheme, self.trained_on, number_surveys(self.labels))


def gather_training(
    patches: SceneCollection,
    patch_labels: SceneCollection,
    ground: GroundParameters,
    sizes: PatchParameters,
    survey: SurveyParameters,
    classes: Mapping[str, Any],
) -> TrainingScenes:
    """Name what the methods that label patches learn from."""
    trained_on = {"survey": survey.root, "splits": str(survey.splits.get("train")), "scenes": len(patch_labels)}
    scheme = find_scheme(classes["schemes"], survey.scheme)
    return TrainingScenes(patches, patch_labels, PatchStages(ground, sizes), scheme, trained_on)


def gathering() -> Node:
    """Return the node that names the training scenes; the pipelines of all methods share it."""
    inputs = ["patches", "patch_labels", *(f"params:{name}" for name in ("ground_removal", "patches", "survey"))]
    return Node(
        gather_training, inputs=[*inputs, "params:classes"], outputs="patch_training", name="gather_patch_training"
    )


def training_node(
    train: Callable[..., ModelBundle], parameters: type
) -> Callable[..., tuple[ModelBundle, ModelBundle]]:
    """Return the node that trains a method on patches."""

    def train_method(training: TrainingScenes, parameters: Any) -> tuple[ModelBundle, ModelBundle]:
        bundle = train(training.load(), parameters=parameters, n_threads=cpu_count())
        return bundle, bundle

    # Kedro reads here which class the parameters become.
    train_method.__annotations__["parameters"] = parameters
    return train_method


def patch_pipeline(
    slug: str,
    train: Callable[..., Any],
    classifier: type[PatchClassifier],
    *,
    more_inputs: Sequence[str] = (),
    more_outputs: Sequence[str] = (),
) -> Pipeline:
    """Wire a method that labels patches."""

    def label_scenes(scenes: SceneCollection, patches: SceneCollection, model: SourceFile) -> dict[str, SceneTask]:
        inputs = {"scene": scenes, "patches": patches, "model": model}
        return scene_tasks(held_out_keys(scenes), label_prepared_patches, inputs, {"classifier": classifier})

    return Pipeline(
        [
            gathering(),
            Node(
                train,
                inputs=["patch_training", f"params:{slug}", *more_inputs],
                outputs=[f"{slug}.model", f"{slug}.registered_model", *more_outputs],
                name=f"train_{slug}",
            ),
            Node(
                label_scenes,
                inputs=["scenes", "patches", f"{slug}.model"],
                outputs=f"{slug}.labels",
                name=f"label_by_{slug}",
            ),
        ]
    )

"""Shapes of objects learned from the training scenes and recognised in the others."""

from __future__ import annotations

from mlsroad_pipeline.algorithms.baselines.shape_based.labeller import ShapeParameters, fit, training_objects
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.datasets.scene_store_dataset import SceneCollection
from mlsroad_pipeline.execution.task import SceneTask, SourceFile, scene_tasks
from mlsroad_pipeline.pipelines.method_work import label_prepared_objects
from mlsroad_pipeline.pipelines.patch_method import TrainingScenes
from mlsroad_pipeline.surveys.plan import held_out_keys, training_keys


def take_training_objects(
    scenes: SceneCollection,
    ground: SceneCollection,
    patches: SceneCollection,
    training: TrainingScenes,
    parameters: ShapeParameters,
) -> dict[str, SceneTask]:
    """Name the work that cuts the objects out of each training scene."""
    inputs = {"scene": scenes, "ground": ground, "patches": patches}
    fixed = {"scheme": training.scheme, "parameters": parameters}
    return scene_tasks(training_keys(scenes), training_objects, inputs, fixed)


def train_shape_based(
    training: TrainingScenes, parameters: ShapeParameters, objects: SceneCollection
) -> tuple[ModelBundle, ModelBundle]:
    """Train the forest that classifies objects."""
    bundle = fit(
        list(objects.load_all().values()),
        parameters=parameters,
        stages=training.stages,
        scheme=training.scheme,
        trained_on=training.trained_on,
    )
    return bundle, bundle


def label_scenes_by_shape(
    scenes: SceneCollection, ground: SceneCollection, patches: SceneCollection, model: SourceFile
) -> dict[str, SceneTask]:
    """Name the work that labels the objects of each scene that the model was not trained on."""
    inputs = {"scene": scenes, "ground": ground, "patches": patches, "model": model}
    return scene_tasks(held_out_keys(scenes), label_prepared_objects, inputs)

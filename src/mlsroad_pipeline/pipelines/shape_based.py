"""Shape-based recognition of objects (Golovinskiy et al. 2009, a baseline of Luo et al. 2016)."""

from kedro.pipeline import Pipeline

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.execution.collection import SceneCollection
from mlsroad_pipeline.papers.luo2016.shape_based.labeller import ShapeParameters, fit, label_objects, training_objects
from mlsroad_pipeline.pipelines.patch_labellers import TrainingScenes, gathering
from mlsroad_pipeline.pipelines.per_scene import MODEL, named_node, scene_node
from mlsroad_pipeline.pipelines.training_facts import labelling
from mlsroad_pipeline.surveys.plan import training_keys


def scheme_of(training: TrainingScenes) -> ClassScheme:
    """Return the classes that the method is trained on."""
    return training.scheme


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


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline: objects to a model, and to labels of the scenes that it was not trained on."""
    inputs = {"training": "patch_training", "parameters": "params:shape_based"}
    taken, draw = "shape_based.training_set", {"keys": training_keys, "scheme": scheme_of}
    return Pipeline(
        [
            gathering(),
            scene_node(training_objects, taken, "take_training_objects", inputs=inputs, **draw),
            named_node(train_shape_based, MODEL, slug="shape_based", training="patch_training", objects=taken),
            labelling(label_objects, "shape_based", "label_scenes_by_shape"),
        ]
    )

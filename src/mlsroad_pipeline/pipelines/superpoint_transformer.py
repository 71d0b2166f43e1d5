"""Superpoint transformer (Robert et al. 2023)."""

from collections.abc import Mapping
from typing import Any

import pandas as pd
from kedro.pipeline import Pipeline

from mlsroad_pipeline.algorithms.core.stage_parameters import (
    FeatureParameters,
    GroundParameters,
    StageParameters,
    SupervoxelParameters,
)
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.models.methods import METHODS
from mlsroad_pipeline.algorithms.models.superpoint_transformer.labeller import label_scene
from mlsroad_pipeline.algorithms.models.superpoint_transformer.parameters import SLUG, SuperpointTransformerParameters
from mlsroad_pipeline.algorithms.models.superpoint_transformer.training_graphs import training_graphs
from mlsroad_pipeline.execution.collection import SceneCollection
from mlsroad_pipeline.pipelines.per_scene import MODEL, named_node, scene_node
from mlsroad_pipeline.pipelines.schemes import training_scheme
from mlsroad_pipeline.pipelines.training_facts import describing, labelling, with_training_facts
from mlsroad_pipeline.surveys.parameters import SurveyParameters
from mlsroad_pipeline.surveys.plan import training_keys


def stages_of(
    ground_removal: GroundParameters, supervoxelise: SupervoxelParameters, description: FeatureParameters
) -> StageParameters:
    """Return the parameters of the stages before the network."""
    return StageParameters(ground_removal, supervoxelise, description)


def parameters_of_graphs(own: SuperpointTransformerParameters) -> SuperpointTransformerParameters:
    """Return the parameters that change the graphs; training graphs stay valid when others change."""
    return own.of_graphs()


def train_network(
    graphs: SceneCollection,
    parameters: SuperpointTransformerParameters,
    ground: GroundParameters,
    supervoxels: SupervoxelParameters,
    features: FeatureParameters,
    survey: SurveyParameters,
    classes: Mapping[str, Any],
    checkpoints: Any,
    scene_facts: SceneCollection,
) -> tuple[ModelBundle, ModelBundle, pd.DataFrame]:
    """Train the network on the graphs of the training scenes."""
    model, losses = METHODS[SLUG].load("train")(
        [graph for views in graphs.load_all().values() for graph in views.values()],
        parameters=parameters,
        stages=StageParameters(ground, supervoxels, features),
        scheme=training_scheme(survey, classes),
        trained_on={"survey": survey.root, "splits": str(survey.splits.get("train")), "scenes": len(graphs)},
        checkpoints=checkpoints,
    )
    model = with_training_facts(model, scene_facts)
    return model, model, pd.DataFrame({"step": range(len(losses)), "loss": losses})


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline: graphs of superpoints to a model, and to labels of the scenes it was not trained on."""
    own, drawn = f"params:{SLUG}", f"{SLUG}.training_set"
    stages = [f"params:{name}" for name in ("ground_removal", "supervoxelise", "features")]
    inputs = dict(zip(("own", "ground_removal", "supervoxelise", "description"), [own, *stages], strict=True))
    draw = {"keys": training_keys, "parameters": parameters_of_graphs, "stages": stages_of, "scheme": training_scheme}
    return Pipeline(
        [
            describing(),
            scene_node(training_graphs, drawn, "build_training_graphs", inputs=inputs, **draw),
            named_node(train_network, [*MODEL, ".objective"], f"train_{SLUG}", slug=SLUG, graphs=drawn),
            labelling(label_scene, SLUG),
        ]
    )

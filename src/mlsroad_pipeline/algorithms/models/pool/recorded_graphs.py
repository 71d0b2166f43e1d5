"""Training graphs of recordings for the network of a pool.

A recording may separate fewer classes than the network: its vegetation is trees and shrubs. The trees of the pool,
which learn from such labels directly, choose among the classes that the label of a point allows.
"""

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import IGNORE, TAXONOMY, ClassScheme
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.stage_parameters import StageParameters
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.models.labelling import label_softly
from mlsroad_pipeline.algorithms.models.superpoint_transformer.labeller import prepare
from mlsroad_pipeline.algorithms.models.superpoint_transformer.parameters import SuperpointTransformerParameters
from mlsroad_pipeline.algorithms.models.superpoint_transformer.training_graphs import training_graphs


def refined_labels(
    scene: PointCloud, trees: ModelBundle, *, scheme: ClassScheme, coarse: ClassScheme
) -> NDArray[np.uint8]:
    """Return taxonomy codes of the most probable classes of `scheme` among those that the coarse labels allow."""
    truth = coarse.encode(scene["label"], source=scene.source)
    soft = label_softly(trees, scene.without_columns(["label"]))
    refined = np.full(len(scene), IGNORE, np.int16)
    if soft.probabilities is not None and soft.owner is not None:
        for label, members in enumerate(_classes_of(scheme, coarse)):
            rows = np.flatnonzero((truth == label) & (soft.owner >= 0))
            if len(members):
                refined[rows] = members[soft.probabilities[:, members].argmax(axis=1)[soft.owner[rows]]]
    codes = np.array([TAXONOMY[names[0]] for names in scheme.members] + [TAXONOMY["unlabelled"]], np.uint8)
    return codes[refined]


def _classes_of(scheme: ClassScheme, coarse: ClassScheme) -> list[NDArray[np.int64]]:
    """Return the classes of a scheme that each class of a coarser one holds."""
    table = scheme.coarsen(coarse)
    return [np.flatnonzero(table == label) for label in range(len(coarse))]


def recorded_graphs(
    scene: PointCloud,
    trees: ModelBundle,
    *,
    parameters: SuperpointTransformerParameters,
    stages: StageParameters,
    scheme: ClassScheme,
    coarse: ClassScheme,
) -> dict[str, dict[str, NDArray]]:
    """Return the labelled graphs of a scene of a recording, as `training_graphs`."""
    labelled = scene.with_columns(label=refined_labels(scene, trees, scheme=scheme, coarse=coarse))
    prepared = prepare(labelled, stages, fresh=True)
    return training_graphs(labelled, *prepared, parameters=parameters, stages=stages, scheme=scheme)

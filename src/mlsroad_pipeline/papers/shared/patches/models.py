"""Training and use of the patch labellers of the table of methods.

Functions of other modules of this package are run as tasks, whose fingerprints cover what these modules import: the
table of methods, which reaches all methods, is read here alone.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.labels import unlabelled
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.models.methods import METHODS
from mlsroad_pipeline.algorithms.stages import inliers
from mlsroad_pipeline.papers.shared.patches.labelling import label_patch_scene, prepare_cloud
from mlsroad_pipeline.papers.shared.patches.training import PatchTraining, bundle_model


def train(training: PatchTraining, *, slug: str, parameters: Any, n_threads: int = 1) -> ModelBundle:
    """Fit the classifier of a method to the training scenes and pack it, with the facts of `describe` if any."""
    kind, n_classes = METHODS[slug].load("use"), len(training.scheme)
    classifier = kind.fit(
        training.patches, training.edges, parameters=parameters, n_classes=n_classes, n_threads=n_threads
    )
    facts = classifier.describe() if hasattr(classifier, "describe") else {}
    return bundle_model(slug, classifier, training, parameters=parameters, facts=facts)


def label_cloud(cloud: PointCloud, bundle: ModelBundle) -> tuple[NDArray[np.int16], NDArray[np.float32]]:
    """Label the points of a cloud: all stages and the classifier."""
    if not inliers(cloud).any():
        return unlabelled(len(cloud))
    _, patches = prepare_cloud(cloud, bundle)
    labels = label_patch_scene(cloud, patches, bundle, METHODS[bundle.slug].load("use"))
    return labels["label"], labels["confidence"]

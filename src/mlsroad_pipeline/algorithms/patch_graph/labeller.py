"""The labellers of Luo et al. 2016: from a cloud that they have never seen to a class for every point."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from numpy import float32, int16
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.classes import ClassScheme
from mlsroad_pipeline.algorithms.model_bundle import ModelBundle
from mlsroad_pipeline.algorithms.patch_graph.classifier import PatchGraphClassifier, PatchGraphParameters
from mlsroad_pipeline.algorithms.patch_graph.refined_classifier import (
    GridParameters,
    RefinedPatchGraphClassifier,
    refine_classifier,
)
from mlsroad_pipeline.algorithms.patch_graph.refinement import GroundClasses
from mlsroad_pipeline.algorithms.patch_labelling import (
    PatchStages,
    bundle_model,
    join_training_scenes,
    label_patch_cloud,
)
from mlsroad_pipeline.algorithms.point_cloud import PointCloud

SLUG, REFINED_SLUG = "patch_graph", "patch_graph_mrf"
_MODULE = "mlsroad_pipeline.algorithms.patch_graph.labeller"

Scenes = Mapping[str, Mapping[str, NDArray]]


def label_cloud(cloud: PointCloud, bundle: ModelBundle) -> tuple[NDArray[int16], NDArray[float32]]:
    """Give every point of a cloud a class and a confidence by label transfer.

    Parameters
    ----------
    cloud : PointCloud
        Points; colour is used where the cloud and the model have it.
    bundle : ModelBundle
        A model of `train`.

    Returns
    -------
    labels : ndarray of int16, shape (n,)
        Labels of the model's scheme, -1 for outliers.
    confidence : ndarray of float32, shape (n,)
        Mean probability of the label over the patches around.
    """
    return label_patch_cloud(cloud, bundle, PatchGraphClassifier)


def label_cloud_refined(cloud: PointCloud, bundle: ModelBundle) -> tuple[NDArray[int16], NDArray[float32]]:
    """Give every point of a cloud a class and a confidence by label transfer and its refinement.

    Parameters
    ----------
    cloud : PointCloud
        Points; colour is used where the cloud and the model have it.
    bundle : ModelBundle
        A model of `train_refinement`.

    Returns
    -------
    labels : ndarray of int16, shape (n,)
        Labels of the model's scheme, -1 for outliers.
    confidence : ndarray of float32, shape (n,)
        Mean probability of the label over the patches around.
    """
    return label_patch_cloud(cloud, bundle, RefinedPatchGraphClassifier)


def train(
    scenes: Scenes,
    labels: Scenes,
    *,
    parameters: PatchGraphParameters,
    stages: PatchStages,
    scheme: ClassScheme,
    trained_on: Mapping[str, Any],
    n_threads: int = 1,
) -> ModelBundle:
    """Build the match graph of the training scenes.

    Parameters
    ----------
    scenes : mapping of str to mapping
        What `build_patches` gave for each scene.
    labels : mapping of str to mapping
        What `label_patches` gave for each training scene.
    parameters : PatchGraphParameters
        Parameters of the graph.
    stages : PatchStages
        How the scenes were prepared.
    scheme : ClassScheme
        The classes.
    trained_on : mapping
        What the metadata say of the training data.
    n_threads : int, default 1
        Threads; the result does not depend on it.

    Returns
    -------
    ModelBundle
        The model; ``objective`` in its arrays is equation 1 after every iteration.

    Raises
    ------
    DataError
        If there are too few training scenes, or none of their patches is labelled.
    """
    patches, edges = join_training_scenes(scenes, labels)
    classifier = PatchGraphClassifier.fit(patches, edges, len(scheme), parameters=parameters, n_threads=n_threads)
    return bundle_model(
        SLUG,
        classifier,
        patches,
        entry_point=f"{_MODULE}:label_cloud",
        parameters=parameters,
        stages=stages,
        scheme=scheme,
        trained_on=trained_on,
        facts={"objective": classifier.graph.objective.tolist(), "graph_nodes": len(classifier.graph.labels)},
    )


def ground_classes(scheme: ClassScheme) -> GroundClasses:
    """Find the classes of grass and road in a scheme.

    Parameters
    ----------
    scheme : ClassScheme
        The classes.

    Returns
    -------
    GroundClasses
        Their labels; the same where one class holds both, -1 where none holds it.
    """
    places = {member: place for place, members in enumerate(scheme.members) for member in members}
    return GroundClasses(grass=places.get("grass", -1), road=places.get("road", -1))


def train_refinement(
    scenes: Scenes,
    labels: Scenes,
    transfer: ModelBundle,
    *,
    graph_parameters: PatchGraphParameters,
    grid: GridParameters,
    stages: PatchStages,
    scheme: ClassScheme,
) -> ModelBundle:
    """Choose the parameters of the Markov random field on the training scenes.

    Parameters
    ----------
    scenes : mapping of str to mapping
        What `build_patches` gave for each scene.
    labels : mapping of str to mapping
        What `label_patches` gave for each training scene.
    transfer : ModelBundle
        What `train` made of the same scenes.
    graph_parameters : PatchGraphParameters
        The parameters it was made with.
    grid : GridParameters
        What to choose from.
    stages : PatchStages
        How the scenes were prepared.
    scheme : ClassScheme
        The classes.

    Returns
    -------
    ModelBundle
        The model; its metadata say what was chosen and how every choice did.

    Raises
    ------
    DataError
        If the model is not one of `train`.
    """
    patches, edges = join_training_scenes(scenes, labels)
    classifier, tried = refine_classifier(
        PatchGraphClassifier.from_arrays(transfer.arrays),
        patches,
        edges,
        graph_parameters=graph_parameters,
        grid=grid,
        ground=ground_classes(scheme),
    )
    chosen = {"smoothness": classifier.parameters.smoothness, "colour_decay": classifier.parameters.colour_decay}
    return bundle_model(
        REFINED_SLUG,
        classifier,
        patches,
        entry_point=f"{_MODULE}:label_cloud_refined",
        parameters=grid,
        stages=stages,
        scheme=scheme,
        trained_on=transfer.metadata["trained_on"],
        facts={"chosen": chosen, "grid": tried, "graph": transfer.metadata["parameters"][SLUG]},
    )

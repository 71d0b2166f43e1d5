"""Training and use of the labellers of Luo et al. 2016."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.models.methods import METHODS
from mlsroad_pipeline.papers.luo2016.patch_graph.classifier import PatchGraphClassifier, PatchGraphParameters
from mlsroad_pipeline.papers.luo2016.patch_graph.refined_classifier import (
    GridParameters,
    RefinedPatchGraphClassifier,
    refine_classifier,
)
from mlsroad_pipeline.papers.luo2016.patch_graph.refinement import GroundClasses
from mlsroad_pipeline.papers.shared.patches.labelling import label_patch_cloud
from mlsroad_pipeline.papers.shared.patches.training import PatchTraining, bundle_model, train_model

SLUG, REFINED_SLUG = "patch_graph", "patch_graph_mrf"
PRINTED_SLUG, REFINED_PRINTED_SLUG = "patch_graph_printed", "patch_graph_mrf_printed"

label_cloud = partial(label_patch_cloud, classifier=PatchGraphClassifier)
"""Entry point of models of `train`."""

label_cloud_refined = partial(label_patch_cloud, classifier=RefinedPatchGraphClassifier)
"""Entry point of models of `train_refinement`."""


def _describe(classifier: PatchGraphClassifier) -> dict[str, Any]:
    graph = classifier.graph
    return {"objective": graph.objective.tolist(), "graph_nodes": len(graph.labels)}


train = partial(train_model, slug=SLUG, fit=PatchGraphClassifier.fit, describe=_describe)
"""Trains a model on a `PatchTraining` with `PatchGraphParameters`; its metadata hold the objective (equation 1)."""

train_printed = partial(train_model, slug=PRINTED_SLUG, fit=PatchGraphClassifier.fit, describe=_describe)
"""`train` for the method with the parameters of the paper."""


def ground_classes(scheme: ClassScheme) -> GroundClasses:
    """Return the classes of grass and road in a scheme."""
    places = {member: place for place, members in enumerate(scheme.members) for member in members}
    return GroundClasses(grass=places.get("grass", -1), road=places.get("road", -1))


def train_refinement(
    training: PatchTraining,
    transfer: ModelBundle,
    *,
    graph_parameters: PatchGraphParameters,
    parameters: GridParameters,
    slug: str = REFINED_SLUG,
    n_threads: int = 1,
) -> ModelBundle:
    """Choose the parameters of the Markov random field on the training scenes."""
    classifier, tried = refine_classifier(
        PatchGraphClassifier.from_arrays(transfer.arrays),
        training.patches,
        training.edges,
        graph_parameters=graph_parameters,
        grid=parameters,
        ground=ground_classes(training.scheme),
        surveys=training.surveys,
        n_threads=n_threads,
    )
    chosen = {name: getattr(classifier.parameters, name) for name in ("smoothness", "colour_decay", "clique_weight")}
    return bundle_model(
        slug,
        classifier,
        replace(training, trained_on=transfer.metadata["trained_on"]),
        parameters=parameters,
        facts={"chosen": chosen, "grid": tried, "graph": transfer.metadata["parameters"][METHODS[slug].refines]},
    )


train_printed_refinement = partial(train_refinement, slug=REFINED_PRINTED_SLUG)
"""`train_refinement` for the method with the parameters of the paper."""

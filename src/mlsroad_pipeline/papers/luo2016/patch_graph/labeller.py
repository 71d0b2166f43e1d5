"""Training of the label transfer with refinement (Luo et al. 2016, section III-D)."""

from __future__ import annotations

from dataclasses import replace

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.models.methods import METHODS
from mlsroad_pipeline.papers.luo2016.patch_graph.classifier import PatchGraphClassifier, PatchGraphParameters
from mlsroad_pipeline.papers.luo2016.patch_graph.refined_classifier import (
    GridParameters,
    refine_classifier,
)
from mlsroad_pipeline.papers.luo2016.patch_graph.refinement import GroundClasses
from mlsroad_pipeline.papers.shared.patches.training import PatchTraining, bundle_model


def ground_classes(scheme: ClassScheme) -> GroundClasses:
    """Return the classes of grass and road in a scheme."""
    places = {member: place for place, members in enumerate(scheme.members) for member in members}
    return GroundClasses(grass=places.get("grass", -1), road=places.get("road", -1))


def train_refinement(
    training: PatchTraining,
    transfer: ModelBundle,
    *,
    slug: str,
    graph_parameters: PatchGraphParameters,
    parameters: GridParameters,
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

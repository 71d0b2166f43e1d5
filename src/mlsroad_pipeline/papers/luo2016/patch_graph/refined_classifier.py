"""Patch classifier refined by a Markov random field, whose parameters are chosen on held-out training scenes."""

import logging
from collections.abc import Iterator, Mapping
from dataclasses import astuple, dataclass, replace
from itertools import product
from typing import Self

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.validation import check_arrays, check_at_least
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.papers.luo2016.patch_graph import refinement
from mlsroad_pipeline.papers.luo2016.patch_graph.classifier import (
    PatchGraphClassifier,
    PatchGraphParameters,
    class_probabilities,
    cut_scenes,
    match_patches,
)
from mlsroad_pipeline.papers.shared.patches.table import Patches, edges_between
from mlsroad_pipeline.papers.shared.patches.training import PatchTraining, bundle_model

logger = logging.getLogger(__name__)


def label_held_out(
    transfer: PatchGraphClassifier,
    patches: Patches,
    edges: NDArray[np.int32],
    *,
    parameters: PatchGraphParameters,
    max_patches: int,
    surveys: NDArray[np.int32] | None = None,
    n_folds: int = 3,
    n_threads: int = 1,
) -> list[refinement.ValidationScene]:
    """Label training scenes by matches in other training scenes.

    With two or more surveys, whole surveys are held out: the surveys of a fold are labelled by a graph of the other
    folds.
    """
    whole = cut_scenes(patches, parameters.scene_length)
    pieces = np.unique(whole.scene)
    n_taken = min(len(pieces), max(1, round(len(pieces) * max_patches / len(whole))))
    drawn = pieces[np.unique(np.linspace(0, len(pieces) - 1, n_taken).round()).astype(np.int64)]
    fold = None if surveys is None else _folds(patches, whole.scene, surveys, n_folds, parameters.n_matches)
    labelled: dict[int, refinement.ValidationScene] = {}
    if fold is None:
        for place in drawn.tolist():
            scene, inside = _piece(whole, edges, place)
            apart = np.full(len(scene), np.searchsorted(pieces, place))
            matched = match_patches(
                scene, transfer.graph, weights=transfer.weights, search=transfer.search, own_scene=apart,
                n_threads=n_threads,
            )  # fmt: skip
            votes = class_probabilities(transfer.graph.labels[matched.matches], transfer.n_classes)
            labelled[place] = refinement.ValidationScene(votes, scene.rgb, inside, scene.label, scene.positions)
        return list(labelled.values())
    for number, rows in _held_out(fold):
        others = PatchGraphClassifier.fit(
            patches.take(~rows),
            edges_between(edges, ~rows),
            transfer.n_classes,
            parameters=parameters,
            n_threads=n_threads,
        )
        logger.info("fold %d: %d of %d patches held out", number, rows.sum(), len(patches))
        for place in np.intersect1d(whole.scene[rows], drawn).tolist():
            scene, inside = _piece(whole, edges, place)
            votes = others.predict_proba(scene, inside)
            labelled[place] = refinement.ValidationScene(votes, scene.rgb, inside, scene.label, scene.positions)
    return [labelled[place] for place in sorted(labelled)]


def _folds(
    patches: Patches, pieces: NDArray[np.int32], surveys: NDArray[np.int32], n_folds: int, n_matches: int
) -> NDArray[np.int64] | None:
    """Return the fold of each patch; None if whole surveys cannot be held out."""
    survey = np.unique(surveys[patches.scene], return_inverse=True)[1].astype(np.int64)
    n_surveys = int(survey.max()) + 1
    if n_folds == 0 or n_surveys == 1:
        return None
    fold = survey % n_folds
    for number in np.unique(fold):
        left = len(np.unique(pieces[fold != number]))
        if left < n_matches + 1:
            logger.warning(
                "patch_graph_mrf: without the surveys of a fold %d training scenes are left, and %d matches need %d: "
                "scenes are held out in place of surveys", left, n_matches, n_matches + 1,
            )  # fmt: skip
            return None
    return fold


def _held_out(fold: NDArray[np.int64]) -> Iterator[tuple[int, NDArray[np.bool_]]]:
    for number in np.unique(fold).tolist():
        yield number, fold == number


def _piece(patches: Patches, edges: NDArray[np.int32], scene: int) -> tuple[Patches, NDArray[np.int32]]:
    rows = patches.scene == scene
    return patches.take(rows), edges_between(edges, rows)


@dataclass(frozen=True)
class GridParameters:
    """Grid of the parameters of the Markov random field; see `RefinementParameters`."""

    smoothness: tuple[float, ...] = (0.1, 0.2, 0.4, 0.8, 1.6, 3.2, 6.4)  # Values of lambda
    colour_decay: tuple[float, ...] = (0.0, 10.0, 50.0)  # Values of beta
    ground_penalty: float = 0.0  # Gamma (luo2016: 0)
    floor: float = 0.01  # Lower bound of the class probabilities
    # Whether to smooth edges within grass and within road (luo2016: no, by equation 11 as printed)
    smooth_ground: bool = False
    # Approximate number of patches for the grid search: whole training scenes, evenly spread
    max_patches: int = 200_000
    # Criterion, computed over patches. The paper reports F1. The overall accuracy weighs classes by their size and
    # favours a larger lambda if small classes have few patches.
    criterion: str = "mean_f1"
    # Folds of whole surveys; each fold trains a graph. With 0, and always with a single survey, scenes are held out and
    # labelled by other scenes of the same survey. That is faster, but favours a smaller lambda than is optimal for a
    # new survey.
    n_folds: int = 3
    clique_weight: tuple[float, ...] = (0.0,)  # Weights of the cliques of separate objects; see `RefinementParameters`
    clique_truncation: float = 0.3  # Share of deviating patches at which a clique has its maximum cost
    mast_radius: float = 0.0  # Radius of the columns around masts; see `RefinementParameters`

    def __post_init__(self) -> None:
        for name in ("smoothness", "colour_decay", "clique_weight"):
            object.__setattr__(self, name, tuple(getattr(self, name)))
            if not getattr(self, name):
                raise ParameterError(f"patch_graph_mrf.{name} must list at least one value")
        for weight, decay, clique in product(self.smoothness, self.colour_decay, self.clique_weight):
            replace(self.base(), smoothness=weight, colour_decay=decay, clique_weight=clique)
        check_at_least(self.max_patches, 1, "patch_graph_mrf.max_patches")
        if self.criterion not in refinement.CRITERIA:
            raise ParameterError(
                f"patch_graph_mrf.criterion must be one of {list(refinement.CRITERIA)}, got {self.criterion!r}"
            )
        if self.n_folds < 0 or self.n_folds == 1:
            raise ParameterError(f"patch_graph_mrf.n_folds must be 0 or at least 2, got {self.n_folds!r}")

    def base(self) -> refinement.RefinementParameters:
        """Return the parameters of the field that are not searched for."""
        return refinement.RefinementParameters(
            ground_penalty=self.ground_penalty, floor=self.floor, smooth_ground=self.smooth_ground,
            clique_truncation=self.clique_truncation, mast_radius=self.mast_radius,
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class RefinedPatchGraphClassifier:
    """Patch classifier by label transfer and a Markov random field."""

    transfer: PatchGraphClassifier
    parameters: refinement.RefinementParameters
    ground: refinement.GroundClasses

    def predict_proba(self, patches: Patches, edges: NDArray[np.int32]) -> NDArray[np.float64]:
        """Return the conditional class probabilities of the patches of one scene."""
        return self.refine(self.transfer.predict_proba(patches, edges), patches, edges)[1]

    def refine(
        self, probabilities: NDArray[np.float64], patches: Patches, edges: NDArray[np.int32]
    ) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
        """Refine transferred probabilities of the patches of one scene."""
        colours = patches.rgb if self.transfer.graph.coloured else None
        return refinement.refine(
            probabilities, colours, edges, parameters=self.parameters, ground=self.ground, positions=patches.positions
        )

    def to_arrays(self) -> dict[str, NDArray]:
        """Return the learned parameters as named arrays."""
        own = {"refinement": np.array(astuple(self.parameters)), "ground": np.array(astuple(self.ground))}
        return {**self.transfer.to_arrays(), **own}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray]) -> Self:
        """Rebuild the classifier from the arrays of `to_arrays`."""
        check_arrays(arrays, ("refinement", "ground"), "a refined patch graph")
        # Models of earlier versions have no cliques.
        smoothness, decay, penalty, floor, smooth_ground, *cliques = np.asarray(arrays["refinement"]).tolist()
        parameters = refinement.RefinementParameters(smoothness, decay, penalty, floor, bool(smooth_ground), *cliques)
        ground = refinement.GroundClasses(*np.asarray(arrays["ground"]).tolist())
        return cls(PatchGraphClassifier.from_arrays(arrays), parameters=parameters, ground=ground)


def refine_classifier(
    transfer: PatchGraphClassifier,
    patches: Patches,
    edges: NDArray[np.int32],
    *,
    graph_parameters: PatchGraphParameters,
    grid: GridParameters,
    ground: refinement.GroundClasses,
    surveys: NDArray[np.int32] | None = None,
    n_threads: int = 1,
) -> tuple[RefinedPatchGraphClassifier, list[dict[str, float]]]:
    """Choose the parameters of the field by cross-validation over training surveys, or over scenes of one survey."""
    scenes = label_held_out(
        transfer, patches, edges, parameters=graph_parameters, max_patches=grid.max_patches, surveys=surveys,
        n_folds=grid.n_folds, n_threads=n_threads,
    )  # fmt: skip
    parameters, tried = refinement.choose_parameters(
        scenes, smoothness=grid.smoothness, colour_decay=grid.colour_decay, clique_weight=grid.clique_weight,
        criterion=grid.criterion, base=grid.base(), ground=ground,
    )  # fmt: skip
    return RefinedPatchGraphClassifier(transfer, parameters=parameters, ground=ground), tried


def ground_classes(scheme: ClassScheme) -> refinement.GroundClasses:
    """Return the classes of grass and road in a scheme."""
    places = {member: place for place, members in enumerate(scheme.members) for member in members}
    return refinement.GroundClasses(grass=places.get("grass", -1), road=places.get("road", -1))


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
        facts={"chosen": chosen, "grid": tried, "graph": transfer.metadata["parameters"][transfer.slug]},
    )

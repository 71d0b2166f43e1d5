"""Label transfer and its refinement as classifiers of patches: fit, class probabilities, plain arrays."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import astuple, dataclass, field
from typing import Self

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.patch_graph.costs import CostWeights
from mlsroad_pipeline.algorithms.patch_graph.matching import SearchParameters
from mlsroad_pipeline.algorithms.patch_graph.refinement import (
    GroundClasses,
    RefinementParameters,
    ValidationScene,
    choose_parameters,
    refine,
)
from mlsroad_pipeline.algorithms.patch_graph.training_scenes import cut_scenes, thin_scenes
from mlsroad_pipeline.algorithms.patch_graph.transfer import (
    TrainedGraph,
    class_probabilities,
    match_patches,
    train_graph,
)
from mlsroad_pipeline.algorithms.patches import Patches
from mlsroad_pipeline.algorithms.validation import check_positive


@dataclass(frozen=True)
class PatchGraphParameters:
    """Parameters of the match graph.

    Parameters
    ----------
    n_matches : int, default 7
        K, matches of each patch, all from different scenes (luo2016: 7). More votes smooth the labels.
    scene_length : float, default 10.0
        Training scenes are cut into pieces of about this length in metres (luo2016: 10): more than K are needed.
    max_patches : int, default 10_000
        Most patches of a piece, drawn with every class in its share. Bounds the time and the size of the model.
    seed : int, default 2016
        Seed of the draws and of the search.
    weights : CostWeights
        Weights of the costs.
    search : SearchParameters
        How matches are searched.

    Raises
    ------
    ParameterError
        If a value is outside its domain.
    """

    n_matches: int = 7
    scene_length: float = 10.0
    max_patches: int = 10_000
    seed: int = 2016
    weights: CostWeights = field(default_factory=CostWeights)
    search: SearchParameters = field(default_factory=SearchParameters)

    def __post_init__(self) -> None:
        check_positive(self.scene_length, "patch_graph.scene_length")
        for name, least in (("n_matches", 1), ("max_patches", 1), ("seed", 0)):
            if getattr(self, name) < least:
                raise ParameterError(f"patch_graph.{name} must be at least {least}, got {getattr(self, name)!r}")


@dataclass(frozen=True)
class GridParameters:
    """What the parameters of the Markov random field are chosen from; see `RefinementParameters`.

    Parameters
    ----------
    smoothness : tuple of float, default (0.1, 0.2, 0.4, 0.8, 1.6)
        Values of lambda.
    colour_decay : tuple of float, default (0.0, 10.0, 50.0)
        Values of beta.
    ground_penalty : float, default 0.0
        Gamma (luo2016: 0).
    floor : float, default 0.01
        Least probability of a class.
    max_patches : int, default 200_000
        The choice takes whole training scenes, evenly spread, up to about this many patches.

    Raises
    ------
    ParameterError
        If there is nothing to choose from, or a value is outside its domain.
    """

    smoothness: tuple[float, ...] = (0.1, 0.2, 0.4, 0.8, 1.6)
    colour_decay: tuple[float, ...] = (0.0, 10.0, 50.0)
    ground_penalty: float = 0.0
    floor: float = 0.01
    max_patches: int = 200_000

    def __post_init__(self) -> None:
        if not self.smoothness or not self.colour_decay:
            raise ParameterError("patch_graph_mrf.smoothness and .colour_decay must each list at least one value")
        for weight in self.smoothness:
            for decay in self.colour_decay:
                RefinementParameters(weight, decay, self.ground_penalty, self.floor)
        if self.max_patches < 1:
            raise ParameterError(f"patch_graph_mrf.max_patches must be at least 1, got {self.max_patches!r}")


class PatchGraphClassifier:
    """Label transfer with the 3-D patch match graph.

    Parameters
    ----------
    graph : TrainedGraph
        The trained graph.
    n_classes : int
        Number of classes of the scheme.
    weights : CostWeights
        Weights of the costs.
    search : SearchParameters
        How matches are searched.
    """

    def __init__(
        self, graph: TrainedGraph, n_classes: int, *, weights: CostWeights, search: SearchParameters
    ) -> None:
        self.graph = graph
        self.n_classes = n_classes
        self.weights = weights
        self.search = search

    @classmethod
    def fit(
        cls,
        patches: Patches,
        edges: NDArray[np.int32],
        n_classes: int,
        *,
        parameters: PatchGraphParameters | None = None,
        n_threads: int = 1,
    ) -> PatchGraphClassifier:
        """Build the match graph of labelled patches.

        Parameters
        ----------
        patches : Patches
            Labelled patches of the training scenes.
        edges : ndarray of int32, shape (m, 2)
            Neighbouring patches.
        n_classes : int
            Number of classes of the scheme.
        parameters : PatchGraphParameters, optional
            Parameters of the graph.
        n_threads : int, default 1
            Threads; the result does not depend on it.

        Returns
        -------
        PatchGraphClassifier
            The classifier.

        Raises
        ------
        DataError
            If the scenes are too few, or a class is outside the scheme.
        """
        chosen = parameters or PatchGraphParameters()
        if len(patches) and patches.label.max() >= n_classes:
            raise DataError(f"patches have class {patches.label.max()}, the scheme has {n_classes} classes")
        used, _ = select_training(patches, edges, chosen)
        graph = train_graph(
            used,
            n_matches=chosen.n_matches,
            weights=chosen.weights,
            search=chosen.search,
            seed=chosen.seed,
            n_threads=n_threads,
        )
        return cls(graph, n_classes, weights=chosen.weights, search=chosen.search)

    def predict_proba(self, patches: Patches, edges: NDArray[np.int32]) -> NDArray[np.float64]:
        """Return the class probabilities of the patches of one scene, equation 6.

        Parameters
        ----------
        patches : Patches
            The patches; colour is left out where they or the training scenes have none.
        edges : ndarray of int32, shape (m, 2)
            Not used.

        Returns
        -------
        ndarray of float64, shape (n, n_classes)
            Probabilities.

        Raises
        ------
        DataError
            If the histograms have another length than those of the training.
        """
        del edges
        found = match_patches(patches, self.graph, weights=self.weights, search=self.search)
        return class_probabilities(self.graph.labels[found.matches], self.n_classes)

    def to_arrays(self) -> dict[str, NDArray]:
        """Return all that was learned as named plain arrays."""
        return {
            **self.graph.to_arrays(),
            "n_classes": np.array(self.n_classes),
            "weights": np.array(astuple(self.weights)),
            "search": np.array(astuple(self.search), np.float64),
        }

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray]) -> Self:
        """Rebuild the classifier from what `to_arrays` returned.

        Parameters
        ----------
        arrays : mapping of str to ndarray
            The arrays.

        Returns
        -------
        PatchGraphClassifier
            The classifier.

        Raises
        ------
        DataError
            If an array is missing.
        """
        graph = TrainedGraph.from_arrays(arrays)
        missing = [name for name in ("n_classes", "weights", "search") if name not in arrays]
        if missing:
            raise DataError(f"the arrays of a patch graph lack {', '.join(missing)}")
        weights = CostWeights(*np.asarray(arrays["weights"]).tolist())
        return cls(graph, int(arrays["n_classes"]), weights=weights, search=_search(arrays["search"]))


class RefinedPatchGraphClassifier:
    """Label transfer refined by a Markov random field.

    Parameters
    ----------
    transfer : PatchGraphClassifier
        Label transfer.
    parameters : RefinementParameters
        Parameters of the field.
    ground : GroundClasses
        The labels of grass and road.
    """

    def __init__(
        self, transfer: PatchGraphClassifier, *, parameters: RefinementParameters, ground: GroundClasses
    ) -> None:
        self.transfer = transfer
        self.parameters = parameters
        self.ground = ground

    def predict_proba(self, patches: Patches, edges: NDArray[np.int32]) -> NDArray[np.float64]:
        """Return the conditional class probabilities of the patches of one scene in the refined field.

        Parameters
        ----------
        patches : Patches
            The patches.
        edges : ndarray of int32, shape (m, 2)
            Neighbouring patches, each pair once.

        Returns
        -------
        ndarray of float64, shape (n, n_classes)
            Probabilities; the refined label has the largest.

        Raises
        ------
        DataError
            If the histograms have another length than those of the training, or an edge names no patch.
        """
        probabilities = self.transfer.predict_proba(patches, edges)
        colours = patches.rgb if self.transfer.graph.coloured else None
        return refine(probabilities, colours, edges, parameters=self.parameters, ground=self.ground)[1]

    def to_arrays(self) -> dict[str, NDArray]:
        """Return all that was learned as named plain arrays."""
        own = {"refinement": np.array(astuple(self.parameters)), "ground": np.array(astuple(self.ground))}
        return {**self.transfer.to_arrays(), **own}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray]) -> Self:
        """Rebuild the classifier from what `to_arrays` returned.

        Parameters
        ----------
        arrays : mapping of str to ndarray
            The arrays.

        Returns
        -------
        RefinedPatchGraphClassifier
            The classifier.

        Raises
        ------
        DataError
            If an array is missing.
        """
        missing = [name for name in ("refinement", "ground") if name not in arrays]
        if missing:
            raise DataError(f"the arrays of a refined patch graph lack {', '.join(missing)}")
        parameters = RefinementParameters(*np.asarray(arrays["refinement"]).tolist())
        ground = GroundClasses(*np.asarray(arrays["ground"]).tolist())
        return cls(PatchGraphClassifier.from_arrays(arrays), parameters=parameters, ground=ground)


def select_training(
    patches: Patches, edges: NDArray[np.int32], parameters: PatchGraphParameters
) -> tuple[Patches, NDArray[np.int32]]:
    """Cut the training scenes to their length and thin them.

    Parameters
    ----------
    patches : Patches
        Labelled patches of the training scenes.
    edges : ndarray of int32, shape (m, 2)
        Neighbouring patches.
    parameters : PatchGraphParameters
        Length, most patches and seed.

    Returns
    -------
    patches : Patches
        What the graph is built of.
    edges : ndarray of int32
        The edges among them.
    """
    short = cut_scenes(patches, parameters.scene_length)
    return thin_scenes(short, edges, n_patches=parameters.max_patches, seed=parameters.seed)


def refine_classifier(
    transfer: PatchGraphClassifier,
    patches: Patches,
    edges: NDArray[np.int32],
    *,
    graph_parameters: PatchGraphParameters,
    grid: GridParameters,
    ground: GroundClasses,
) -> tuple[RefinedPatchGraphClassifier, list[dict[str, float]]]:
    """Choose the parameters of the field by cross-validation over the training scenes.

    Matches come from other scenes, so that the graph labels every training scene without its own labels.

    Parameters
    ----------
    transfer : PatchGraphClassifier
        Label transfer, fitted on the patches.
    patches : Patches
        Labelled patches of the training scenes.
    edges : ndarray of int32, shape (m, 2)
        Neighbouring patches.
    graph_parameters : PatchGraphParameters
        The parameters of the fit.
    grid : GridParameters
        What to choose from.
    ground : GroundClasses
        The labels of grass and road.

    Returns
    -------
    classifier : RefinedPatchGraphClassifier
        The refined classifier.
    tried : list of dict
        What `choose_parameters` tells of every choice.
    """
    used, pairs = select_training(patches, edges, graph_parameters)
    graph = transfer.graph
    probabilities = np.empty((len(used), transfer.n_classes))
    probabilities[graph.rows] = class_probabilities(graph.labels[graph.matches], transfer.n_classes)
    scenes = _validation_scenes(used, pairs, probabilities, grid.max_patches)
    base = RefinementParameters(ground_penalty=grid.ground_penalty, floor=grid.floor)
    parameters, tried = choose_parameters(
        scenes, smoothness=grid.smoothness, colour_decay=grid.colour_decay, base=base, ground=ground
    )
    return RefinedPatchGraphClassifier(transfer, parameters=parameters, ground=ground), tried


def _validation_scenes(
    patches: Patches, edges: NDArray[np.int32], probabilities: NDArray[np.float64], max_patches: int
) -> list[ValidationScene]:
    n_scenes = int(patches.scene.max()) + 1
    wanted = min(n_scenes, max(1, round(n_scenes * max_patches / len(patches))))
    scenes = []
    for scene in np.unique(np.linspace(0, n_scenes - 1, wanted).round()).astype(int).tolist():
        members = np.flatnonzero(patches.scene == scene)
        place = np.full(len(patches), -1, np.int32)
        place[members] = np.arange(len(members))
        pairs = place[edges]
        colours = None if patches.rgb is None else patches.rgb[members]
        inside = pairs[(pairs >= 0).all(axis=1)]
        scenes.append(ValidationScene(probabilities[members], colours, inside, patches.label[members]))
    return scenes


def _search(values: NDArray) -> SearchParameters:
    kinds = [type(value) for value in astuple(SearchParameters())]
    return SearchParameters(*[kind(value) for kind, value in zip(kinds, np.asarray(values).tolist(), strict=True)])

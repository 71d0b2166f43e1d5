"""Label transfer refined by a Markov random field, as a classifier of patches."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import astuple, dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.patch_graph.classifier import (
    PatchGraphClassifier,
    PatchGraphParameters,
)
from mlsroad_pipeline.algorithms.patch_graph.refinement import (
    GroundClasses,
    RefinementParameters,
    ValidationScene,
    choose_parameters,
    refine,
)
from mlsroad_pipeline.algorithms.patch_graph.training_scenes import cut_scenes
from mlsroad_pipeline.algorithms.patch_graph.transfer import class_probabilities, match_patches
from mlsroad_pipeline.algorithms.patches import Patches


@dataclass(frozen=True)
class GridParameters:
    """What the parameters of the Markov random field are chosen from; see `RefinementParameters`.

    Parameters
    ----------
    smoothness : tuple of float, default (0.1, 0.2, 0.4, 0.8, 1.6, 3.2, 6.4)
        Values of lambda.
    colour_decay : tuple of float, default (0.0, 10.0, 50.0)
        Values of beta.
    ground_penalty : float, default 0.0
        Gamma (luo2016: 0).
    floor : float, default 0.01
        Least probability of a class.
    smooth_ground : bool, default False
        Whether edges inside grass and inside road are smoothed (luo2016: not, as equation 11 is printed).
    max_patches : int, default 200_000
        The choice takes whole training scenes, evenly spread, up to about this many patches.

    Raises
    ------
    ParameterError
        If there is nothing to choose from, or a value is outside its domain.
    """

    smoothness: tuple[float, ...] = (0.1, 0.2, 0.4, 0.8, 1.6, 3.2, 6.4)
    colour_decay: tuple[float, ...] = (0.0, 10.0, 50.0)
    ground_penalty: float = 0.0
    floor: float = 0.01
    smooth_ground: bool = False
    max_patches: int = 200_000

    def __post_init__(self) -> None:
        for name in ("smoothness", "colour_decay"):
            object.__setattr__(self, name, tuple(getattr(self, name)))
        if not self.smoothness or not self.colour_decay:
            raise ParameterError("patch_graph_mrf.smoothness and .colour_decay must each list at least one value")
        for weight in self.smoothness:
            for decay in self.colour_decay:
                RefinementParameters(weight, decay, self.ground_penalty, self.floor)
        if self.max_patches < 1:
            raise ParameterError(f"patch_graph_mrf.max_patches must be at least 1, got {self.max_patches!r}")


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
        smoothness, decay, penalty, floor, smooth_ground = np.asarray(arrays["refinement"]).tolist()
        parameters = RefinementParameters(smoothness, decay, penalty, floor, bool(smooth_ground))
        ground = GroundClasses(*np.asarray(arrays["ground"]).tolist())
        return cls(PatchGraphClassifier.from_arrays(arrays), parameters=parameters, ground=ground)


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

    The graph labels training scenes by matches in the other scenes alone, and labels whole ones: thinned scenes have
    fewer edges than those that are to be labelled, and would ask for a larger lambda.

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
    scenes = _validation_scenes(transfer, patches, edges, graph_parameters, grid.max_patches)
    base = RefinementParameters(ground_penalty=grid.ground_penalty, floor=grid.floor, smooth_ground=grid.smooth_ground)
    parameters, tried = choose_parameters(
        scenes, smoothness=grid.smoothness, colour_decay=grid.colour_decay, base=base, ground=ground
    )
    return RefinedPatchGraphClassifier(transfer, parameters=parameters, ground=ground), tried


def _validation_scenes(
    transfer: PatchGraphClassifier,
    patches: Patches,
    edges: NDArray[np.int32],
    graph_parameters: PatchGraphParameters,
    max_patches: int,
) -> list[ValidationScene]:
    """Label training scenes, whole ones, by the graph of the others."""
    whole = cut_scenes(patches, graph_parameters.scene_length)
    in_graph = np.unique(whole.scene)  # thinning leaves patches of every scene
    wanted = min(len(in_graph), max(1, round(len(in_graph) * max_patches / len(whole))))
    places = np.unique(np.linspace(0, len(in_graph) - 1, wanted).round()).astype(np.int64)
    scenes = []
    for place in places.tolist():
        members = np.flatnonzero(whole.scene == in_graph[place])
        own = np.full(len(whole), -1, np.int32)
        own[members] = np.arange(len(members))
        pairs = own[edges]
        inside = pairs[(pairs >= 0).all(axis=1)]
        scene = whole.take(members)
        found = match_patches(
            scene, transfer.graph, weights=transfer.weights, search=transfer.search,
            own_scene=np.full(len(scene), place),
        )  # fmt: skip
        probabilities = class_probabilities(transfer.graph.labels[found.matches], transfer.n_classes)
        scenes.append(ValidationScene(probabilities, scene.rgb, inside, scene.label))
    return scenes

"""Labelling with max-margin Markov networks (Munoz, Bagnell, Vandapel and Hebert 2009).

A rival of Luo et al. 2016 (section IV-C). The score of a labelling is the sum of scores of sites, pairs and cliques,
all learned by boosting (`max_margin_training`). Pairs and cliques score only for agreement, never below 0, so that the
best labelling is sought by minimum cuts; cliques are robust P^n Potts terms over two k-means segmentations.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Self

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.baselines.max_margin_markov.graph import build_markov_graph
from mlsroad_pipeline.algorithms.baselines.max_margin_markov.network import MarkovNetwork
from mlsroad_pipeline.algorithms.patches.extraction import Patches
from mlsroad_pipeline.algorithms.patches.labelling import label_patch_cloud

SLUG = "max_margin_markov"


class MaxMarginMarkov:
    """Labels patches by a max-margin Markov network.

    Parameters
    ----------
    network : MarkovNetwork
        What was learned.
    clique_shares : sequence of float
        Clusters of each segmentation as a share of the patches.
    temperature : float
        What scores are divided by on their way to probabilities.
    colour : ndarray of float32, shape (3,) or (0,)
        Mean colour of the training patches, which stands in where a scene has none; empty where they have none.
    errors : sequence of float
        Share of wrong sites that the search with the loss found in each round of training.
    """

    def __init__(
        self,
        network: MarkovNetwork,
        clique_shares: Sequence[float],
        temperature: float,
        colour: NDArray[np.float32],
        errors: Sequence[float] = (),
    ) -> None:
        self.network = network
        self.clique_shares = tuple(float(share) for share in clique_shares)
        self.temperature = temperature
        self.colour = colour
        self.errors = tuple(errors)

    def predict_proba(self, patches: Patches, edges: NDArray[np.int32]) -> NDArray[np.float64]:
        """Return class probabilities.

        Parameters
        ----------
        patches : Patches
            Patches of one scene. Without colour they take the mean colour of the training patches, where these had one.
        edges : ndarray of int32, shape (e, 2)
            Pairs of patches that touch.

        Returns
        -------
        ndarray of float64, shape (n, n_classes)
            Probabilities given the best labels of all other patches; the largest is that of the best labelling.
        """
        if len(patches) == 0:
            return np.zeros((0, self.network.n_labels))
        if len(self.colour) == 0:
            patches = patches.with_columns(rgb=None)
        elif patches.rgb is None:
            patches = patches.with_columns(rgb=np.tile(self.colour, (len(patches), 1)))
        graph = build_markov_graph(patches, edges, self.clique_shares)
        return self.network.conditional_probabilities(graph, self.temperature)

    def to_arrays(self) -> dict[str, NDArray]:
        """Return all that was learned as named plain arrays."""
        return {
            **self.network.to_arrays(),
            "clique_shares": np.array(self.clique_shares),
            "temperature": np.array(self.temperature),
            "colour": self.colour,
            "errors": np.array(self.errors),
        }

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray]) -> Self:
        """Rebuild a labeller from what `to_arrays` returned.

        Parameters
        ----------
        arrays : mapping of str to ndarray
            The arrays; further entries are left alone.

        Returns
        -------
        MaxMarginMarkov
            The labeller.
        """
        return cls(
            MarkovNetwork.from_arrays(arrays),
            arrays["clique_shares"].tolist(),
            float(arrays["temperature"]),
            arrays["colour"],
            arrays["errors"].tolist(),
        )


label_cloud = partial(label_patch_cloud, classifier=MaxMarginMarkov)
"""Entry point of the models."""

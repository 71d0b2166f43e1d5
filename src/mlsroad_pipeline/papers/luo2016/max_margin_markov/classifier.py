"""Labelling with max-margin Markov networks (Munoz, Bagnell, Vandapel and Hebert 2009).

A baseline of Luo et al. 2016 (section IV-C). The score of a labelling is the sum of scores of sites, pairs and cliques,
learned by boosting (see `training`). Pairs and cliques score only agreement, at least 0, so that minimum cuts apply.
Cliques are robust P^n Potts terms over two k-means segmentations.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Self

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.papers.luo2016.max_margin_markov.graph import build_markov_graph
from mlsroad_pipeline.papers.luo2016.max_margin_markov.network import MarkovNetwork
from mlsroad_pipeline.papers.shared.patches.labelling import label_patch_cloud
from mlsroad_pipeline.papers.shared.patches.table import Patches

SLUG = "max_margin_markov"


class MaxMarginMarkov:
    """Patch classifier with a max-margin Markov network."""

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
        """Return class probabilities."""
        if len(patches) == 0:
            return np.zeros((0, self.network.n_labels))
        if len(self.colour) == 0:
            patches = patches.with_columns(rgb=None)
        elif patches.rgb is None:
            patches = patches.with_columns(rgb=np.tile(self.colour, (len(patches), 1)))
        graph = build_markov_graph(patches, edges, self.clique_shares)
        return self.network.conditional_probabilities(graph, self.temperature)

    def to_arrays(self) -> dict[str, NDArray]:
        """Return the learned parameters as named arrays."""
        return {
            **self.network.to_arrays(),
            "clique_shares": np.array(self.clique_shares),
            "temperature": np.array(self.temperature),
            "colour": self.colour,
            "errors": np.array(self.errors),
        }

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray]) -> Self:
        """Rebuild a classifier from the arrays of `to_arrays`."""
        return cls(
            MarkovNetwork.from_arrays(arrays),
            arrays["clique_shares"].tolist(),
            float(arrays["temperature"]),
            arrays["colour"],
            arrays["errors"].tolist(),
        )


label_cloud = partial(label_patch_cloud, classifier=MaxMarginMarkov)
"""Entry point of the models."""

"""JointNet as an estimator: objects and classes in, probabilities out."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Self

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.features.accumulation_images import join_objects, join_values
from mlsroad_pipeline.algorithms.jointnet.inputs import Points, encode
from mlsroad_pipeline.algorithms.jointnet.network import JointNet
from mlsroad_pipeline.algorithms.jointnet.parameters import JointNetParameters
from mlsroad_pipeline.algorithms.jointnet.training import to_tensors, train_network
from mlsroad_pipeline.algorithms.models.torch_training import find_device, load_weights, reproducible
from mlsroad_pipeline.algorithms.recognition.object_set import check_training

_BATCH = 256
"""Objects that the network sees at once when it recognises."""

logger = logging.getLogger(__name__)


class JointNetRecogniser:
    """Objects recognised by their accumulation images (Luo et al. 2019).

    Parameters
    ----------
    parameters : JointNetParameters, optional
        What it sees, its layers, how it is trained.
    checkpoint : str or Path, optional
        A folder for checkpoints: training that was stopped goes on where it was.
    progress : bool, default False
        Whether bars show how far training is.

    Attributes
    ----------
    classes_ : ndarray
        The classes, sorted; columns of `predict_proba`.
    histories_ : list of list of dict
        Losses of each network and epoch.
    """

    def __init__(
        self,
        parameters: JointNetParameters | None = None,
        *,
        checkpoint: str | Path | None = None,
        progress: bool = False,
    ) -> None:
        self.parameters = parameters if parameters is not None else JointNetParameters()
        self.checkpoint = None if checkpoint is None else Path(checkpoint)
        self.progress = progress

    def fit(
        self, objects: Sequence[ArrayLike], classes: ArrayLike, *, intensities: Sequence[ArrayLike] | None = None
    ) -> Self:
        """Train.

        Parameters
        ----------
        objects : sequence of array-like of shape (n_i, 3)
            Points of each object, metres, z up.
        classes : array-like of shape (objects,)
            The class of each, any sortable values.
        intensities : sequence of array-like of shape (n_i,), optional
            Intensity of each point in [0, 1].

        Returns
        -------
        JointNetRecogniser
            Itself.

        Raises
        ------
        DataError
            If an object is empty or not finite, there is not one class per object, or there is one class alone.
        ReadError
            If a checkpoint is damaged or of another training.
        """
        self.classes_, target = check_training(objects, classes, method="jointnet")
        points = _points(objects, intensities)
        self.networks_, self.histories_ = [], []
        for member in range(self.parameters.training.n_members):
            trained = train_network(
                points,
                target,
                n_classes=len(self.classes_),
                parameters=self.parameters,
                member=member,
                checkpoint=None if self.checkpoint is None else self.checkpoint / f"network_{member}.pt",
                progress=self.progress,
            )
            self.networks_.append(trained.network)
            self.histories_.append(trained.history)
        return self

    def predict_proba(
        self, objects: Sequence[ArrayLike], *, intensities: Sequence[ArrayLike] | None = None
    ) -> NDArray[np.float64]:
        """Return the probability of each class.

        Parameters
        ----------
        objects : sequence of array-like of shape (n_i, 3)
            Points of each object, metres, z up; at least one each.
        intensities : sequence of array-like of shape (n_i,), optional
            Intensity of each point in [0, 1].

        Returns
        -------
        ndarray of float64, shape (objects, classes)
            Probabilities: the softmax of the summed scores, averaged over networks and headings.

        Raises
        ------
        DataError
            If an object is empty or not finite.
        """
        total = np.zeros((len(objects), len(self.classes_)))
        if not len(objects):
            return total
        points, measures = _points(objects, intensities), None
        n_turns = self.parameters.training.n_turns
        for turn in range(n_turns):
            seen = points.turned(2 * np.pi * turn / n_turns) if turn else points
            images, measures = encode(seen, self.parameters.inputs, measures=measures)
            for start in range(0, len(total), _BATCH):
                rows = slice(start, start + _BATCH)
                total[rows] += self._score({view: v[rows] for view, v in images.items()}, measures[rows])
        return total / (n_turns * len(self.networks_))

    def _score(self, images: dict[str, NDArray[np.float32]], measures: NDArray[np.float32]) -> NDArray[np.float64]:
        device = next(self.networks_[0].parameters()).device
        given = to_tensors(images, measures, device)
        with reproducible(0), torch.inference_mode():
            found = [torch.softmax(network(*given), dim=2).mean(dim=0) for network in self.networks_]
            summed: NDArray[np.float64] = torch.stack(found).sum(dim=0).double().cpu().numpy()
        return summed

    def predict(self, objects: Sequence[ArrayLike], *, intensities: Sequence[ArrayLike] | None = None) -> NDArray:
        """Return the class with the highest probability.

        Parameters
        ----------
        objects : sequence of array-like of shape (n_i, 3)
            Points of each object.
        intensities : sequence of array-like of shape (n_i,), optional
            Intensity of each point.

        Returns
        -------
        ndarray of shape (objects,)
            Classes.
        """
        return self.classes_[self.predict_proba(objects, intensities=intensities).argmax(axis=1)]

    def to_arrays(self) -> dict[str, NDArray]:
        """Return the classes and the weights as plain arrays, ``<network>/<layer>``."""
        arrays: dict[str, NDArray] = {"classes": self.classes_}
        for member, network in enumerate(self.networks_):
            for name, value in network.state_dict().items():
                arrays[f"{member}/{name}"] = value.cpu().numpy()
        return arrays

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray], parameters: JointNetParameters) -> Self:
        """Rebuild a recogniser from what `to_arrays` gave.

        Parameters
        ----------
        arrays : mapping of str to ndarray
            Classes and weights.
        parameters : JointNetParameters
            Those that it was trained with.

        Returns
        -------
        JointNetRecogniser
            The same recogniser.

        Raises
        ------
        DataError
            If an array is missing, or the weights are not those of such a network or of as many classes.
        """
        if "classes" not in arrays:
            raise DataError("the arrays of jointnet lack the classes")
        self = cls(parameters)
        self.classes_ = np.array(arrays["classes"])
        self.networks_, self.histories_ = [], []
        device = find_device(parameters.training.device)
        for member in range(parameters.training.n_members):
            network = JointNet(parameters, len(self.classes_))
            load_weights(network, arrays, f"{member}/", f"jointnet with {len(self.classes_)} classes")
            self.networks_.append(network.to(device).eval())
        return self

    def describe(self) -> dict[str, object]:
        """Return the parameters as JSON values."""
        return asdict(self.parameters)


def _points(objects: Sequence[ArrayLike], intensities: Sequence[ArrayLike] | None) -> Points:
    xyz, indptr = join_objects(objects)
    known = np.full(len(objects), intensities is not None)
    values = np.zeros(len(xyz)) if intensities is None else join_values(intensities, indptr, "intensities")
    return Points(xyz, indptr, values, known)

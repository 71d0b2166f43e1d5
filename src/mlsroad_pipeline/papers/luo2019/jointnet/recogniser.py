"""JointNet as an estimator."""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Self

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.features.accumulation_images import concatenate_objects, concatenate_values
from mlsroad_pipeline.algorithms.models.bundle import Checkpoints, arrays_under
from mlsroad_pipeline.algorithms.models.machines.torch_training import (
    find_device,
    load_weights,
    reproducible,
)
from mlsroad_pipeline.papers.luo2019.jointnet.inputs import Points, encode
from mlsroad_pipeline.papers.luo2019.jointnet.network import JointNet, MeasureRegression, train_regression
from mlsroad_pipeline.papers.luo2019.jointnet.parameters import JointNetParameters
from mlsroad_pipeline.papers.luo2019.jointnet.training import to_tensors, train_network
from mlsroad_pipeline.papers.shared.recognition.object_set import check_training

_BATCH = 256
"""Objects per batch in prediction."""

_ALIKE = 0.5
"""Largest difference of the flag of known intensity from its mean in training for which the regression counts."""

_REGRESSION = "machine/"
"""Start of the names of the arrays of the regression, as stored models have it."""

logger = logging.getLogger(__name__)


class JointNetRecogniser:
    """Recogniser of objects by accumulation images (Luo et al. 2019).

    An interrupted training resumes from its `checkpoints`. `regression_` is a kernel logistic regression on the
    measures, None without it; `histories_` has the losses of each network and epoch.
    """

    def __init__(
        self,
        parameters: JointNetParameters | None = None,
        *,
        checkpoints: Checkpoints | None = None,
        progress: bool = False,
    ) -> None:
        self.parameters = parameters if parameters is not None else JointNetParameters()
        self.checkpoints, self.progress = checkpoints, progress

    def fit(
        self, objects: Sequence[ArrayLike], classes: ArrayLike, *, intensities: Sequence[ArrayLike] | None = None
    ) -> Self:
        """Train on points in metres, z up, and intensities in [0, 1]; classes are any sortable values."""
        self.classes_, target = check_training(objects, classes, method="jointnet")
        points = _points(objects, intensities)
        self.networks_, self.histories_ = [], []
        for member in range(self.parameters.training.n_members):
            network, history = train_network(
                points,
                target,
                n_classes=len(self.classes_),
                parameters=self.parameters,
                member=member,
                checkpoints=self.checkpoints,
                progress=self.progress,
            )
            self.networks_.append(network)
            self.histories_.append(history)
        self.regression_ = train_regression(points, target, self.parameters)
        return self

    def predict_proba(
        self, objects: Sequence[ArrayLike], *, intensities: Sequence[ArrayLike] | None = None
    ) -> NDArray[np.float64]:
        """Return the probability of each class: the softmax of the summed scores, averaged over networks and headings.

        It is averaged with that of the regression on the measures. For objects without intensity, only the networks
        count where the training objects have it.
        """
        total = np.zeros((len(objects), len(self.classes_)))
        if not len(objects):
            return total
        points, measures = _points(objects, intensities), None
        n_turns = self.parameters.training.n_turns
        for turn in range(n_turns):
            turned = points.turned(2 * np.pi * turn / n_turns) if turn else points
            images, measures = encode(turned, self.parameters.inputs, measures=measures)
            for start in range(0, len(total), _BATCH):
                rows = slice(start, start + _BATCH)
                total[rows] += self._score({view: v[rows] for view, v in images.items()}, measures[rows])
        total /= n_turns * len(self.networks_)
        if self.regression_ is None or measures is None:
            return total
        alike = np.abs(measures[:, -1:] - self.regression_.shift[-1]) < _ALIKE
        share = self.parameters.training.regression_share * alike
        return (1 - share) * total + share * self.regression_.predict_proba(measures)

    def _score(self, images: dict[str, NDArray[np.float32]], measures: NDArray[np.float32]) -> NDArray[np.float64]:
        device = next(self.networks_[0].parameters()).device
        inputs = to_tensors(images, measures, device)
        with reproducible(0), torch.inference_mode():
            probabilities = [torch.softmax(network(*inputs), dim=2).mean(dim=0) for network in self.networks_]
            summed: NDArray[np.float64] = torch.stack(probabilities).sum(dim=0).double().cpu().numpy()
        return summed

    def predict(self, objects: Sequence[ArrayLike], *, intensities: Sequence[ArrayLike] | None = None) -> NDArray:
        """Return the class with the highest probability."""
        return self.classes_[self.predict_proba(objects, intensities=intensities).argmax(axis=1)]

    def to_arrays(self) -> dict[str, NDArray]:
        """Return the classes and the weights as plain arrays, keys ``<network>/<layer>``."""
        arrays: dict[str, NDArray] = {"classes": self.classes_}
        for member, network in enumerate(self.networks_):
            for name, value in network.state_dict().items():
                arrays[f"{member}/{name}"] = value.cpu().numpy()
        regression = {} if self.regression_ is None else self.regression_.to_arrays()
        return arrays | {f"{_REGRESSION}{name}": value for name, value in regression.items()}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray], parameters: JointNetParameters) -> Self:
        """Rebuild a recogniser from the arrays of `to_arrays`."""
        if "classes" not in arrays:
            raise DataError("the arrays of jointnet lack 'classes'")
        self = cls(parameters)
        self.classes_ = np.array(arrays["classes"])
        self.networks_, self.histories_ = [], []
        device = find_device(parameters.training.device)
        for member in range(parameters.training.n_members):
            network = JointNet(parameters, len(self.classes_))
            load_weights(network, arrays, f"{member}/", f"jointnet with {len(self.classes_)} classes")
            self.networks_.append(network.to(device).eval())
        regression = arrays_under(arrays, _REGRESSION)
        self.regression_ = MeasureRegression.from_arrays(regression) if regression else None
        return self

    def describe(self) -> dict[str, object]:
        """Return the parameters as JSON values."""
        return asdict(self.parameters)


def _points(objects: Sequence[ArrayLike], intensities: Sequence[ArrayLike] | None) -> Points:
    xyz, indptr = concatenate_objects(objects)
    known = np.full(len(objects), intensities is not None)
    values = np.zeros(len(xyz)) if intensities is None else concatenate_values(intensities, indptr, "intensities")
    return Points(xyz, indptr, values, known)

"""Base classes of the baselines of Luo et al. 2019, which use shape alone; most are descriptors with an SVM."""

import warnings
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.model_selection import StratifiedKFold

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.core.validation import check_arrays, check_at_least
from mlsroad_pipeline.algorithms.models.machines.kernel_machine import (
    Folds,
    KernelMachine,
    choose_machine,
    fit_machine,
    standardise,
)
from mlsroad_pipeline.papers.shared.recognition.object_set import check_training


class ShapeRecogniser(ABC):
    """Recogniser by shape; subclasses implement training and prediction."""

    slug: ClassVar[str]

    def __init__(self, parameters: Any) -> None:
        self.parameters = parameters

    def fit(
        self, objects: Sequence[ArrayLike], classes: ArrayLike, *, intensities: Sequence[ArrayLike] | None = None
    ) -> Self:
        """Train."""
        del intensities
        self.classes_, target = check_training(objects, classes, method=self.slug)
        self._learn(objects, target)
        return self

    @abstractmethod
    def _learn(self, objects: Sequence[ArrayLike], target: NDArray[np.int64]) -> None:
        """Train on objects and the indices of their classes."""

    def predict_proba(
        self, objects: Sequence[ArrayLike], *, intensities: Sequence[ArrayLike] | None = None
    ) -> NDArray[np.float64]:
        """Return the class probabilities of objects."""
        del intensities
        return self._probabilities(objects) if len(objects) else np.zeros((0, len(self.classes_)))

    @abstractmethod
    def _probabilities(self, objects: Sequence[ArrayLike]) -> NDArray[np.float64]:
        """Return class probabilities; there is at least one object."""

    @abstractmethod
    def to_arrays(self) -> dict[str, NDArray]:
        """Return the fitted state as plain arrays."""

    @classmethod
    def _restored(cls, arrays: Mapping[str, NDArray], parameters: Any, *names: str) -> Self:
        """Return a recogniser with parameters and classes after checking that all arrays are present."""
        check_arrays(arrays, ("classes", *names), f"{cls.slug}")
        self = cls(parameters)
        self.classes_ = np.array(arrays["classes"])
        return self

    def describe(self) -> dict[str, object]:
        """Return the parameters as JSON values."""
        return asdict(self.parameters)


@dataclass(frozen=True)
class DescriptorParameters:
    """Parameters of a descriptor with a support vector machine."""

    # Candidate radii of the descriptor, selected by cross-validation, metres; 0 is the extent of each object. The
    # hierarchy descriptor has no radius.
    radii: Sequence[float] = field(default_factory=lambda: [0.0, 2.0, 4.0])
    # Candidate values of C. Larger fits single objects more closely.
    costs: Sequence[float] = field(default_factory=lambda: [1.0, 10.0, 100.0])
    # Candidate values of gamma, for features of standard deviation 1
    gammas: Sequence[float] = field(default_factory=lambda: [0.001, 0.003, 0.01, 0.03])
    n_folds: int = 4  # Folds of the cross-validation, at least 2
    max_per_class: int = 1000  # Maximum number of training objects of a class
    seed: int = 2019  # Seed of the folds and of the sample

    def __post_init__(self) -> None:
        for name in ("radii", "costs", "gammas"):
            values = getattr(self, name)
            least = 0.0 if name == "radii" else np.nextafter(0.0, 1.0)
            if not len(values) or not all(np.isfinite(value) and value >= least for value in values):
                above = "at least 0" if name == "radii" else "> 0"
                raise ParameterError(f"{name} must be numbers {above}, got {values!r}")
        for name in ("n_folds", "max_per_class"):
            check_at_least(getattr(self, name), 2, name)


class DescriptorRecogniser(ShapeRecogniser):
    """Descriptor with a support vector machine; subclasses define the descriptor."""

    has_radius: ClassVar[bool] = True

    def __init__(self, parameters: DescriptorParameters | None = None) -> None:
        super().__init__(parameters if parameters is not None else DescriptorParameters())

    @staticmethod
    @abstractmethod
    def describe_objects(objects: Sequence[ArrayLike], radius: float) -> NDArray[np.float32]:
        """Return the descriptors of objects."""

    def _learn(self, objects: Sequence[ArrayLike], target: NDArray[np.int64]) -> None:
        p = self.parameters
        rng = np.random.default_rng(p.seed)
        drawn = [rng.permutation(np.flatnonzero(target == k))[: p.max_per_class] for k in range(len(self.classes_))]
        rows = np.sort(np.concatenate(drawn))
        target, chosen = target[rows], [objects[i] for i in rows]
        folds = self._folds(target)
        tried = []
        for radius in p.radii if self.has_radius else p.radii[:1]:
            features = self.describe_objects(chosen, radius)
            shift, scale = standardise(features)
            scaled = (features - shift) / scale
            tried.append(
                (choose_machine(scaled, target, folds, costs=p.costs, gammas=p.gammas), radius, features, scaled)
            )
        best, self.radius_, features, scaled = max(tried, key=lambda trial: trial[0].mean_f1)
        self.machine_ = fit_machine(features, target, best, held_out=scaled, held_out_labels=target, folds=folds)

    def _folds(self, target: NDArray[np.int64]) -> Folds:
        splitter = StratifiedKFold(self.parameters.n_folds, shuffle=True, random_state=self.parameters.seed)
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message="The least populated class")
            try:
                folds = list(splitter.split(target, target))
            except ValueError as error:
                raise DataError(f"{self.slug}: {len(target)} objects are too few: {error}") from error
        return [fold for fold in folds if len(np.unique(target[fold[0]])) > 1]

    def _probabilities(self, objects: Sequence[ArrayLike]) -> NDArray[np.float64]:
        return self.machine_.predict_proba(self.describe_objects(objects, self.radius_)).astype(np.float64)

    def to_arrays(self) -> dict[str, NDArray]:
        """Return what was learned as plain arrays."""
        return {**self.machine_.to_arrays(), "classes": self.classes_, "radius": np.array(self.radius_)}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray], parameters: DescriptorParameters) -> Self:
        """Rebuild a recogniser from the arrays of `to_arrays`."""
        self = cls._restored(arrays, parameters, "radius")
        self.radius_ = float(arrays["radius"])
        self.machine_ = KernelMachine.from_arrays(arrays)
        if len(self.machine_.n_vectors) != len(self.classes_):
            raise DataError(
                f"the machine of {cls.slug} has {len(self.machine_.n_vectors)} classes, not {len(self.classes_)}"
            )
        return self

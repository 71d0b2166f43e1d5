"""Two classes of patches, below and above a height."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class ToyParameters:
    """Parameters of the method."""

    height: float = 0.3


class Toy:
    """The most frequent training class of the patches below and above a height."""

    def __init__(self, height, classes, n_classes):
        self.height, self.classes, self.n_classes = height, classes, n_classes

    @classmethod
    def fit(cls, patches, edges, *, parameters, n_classes, n_threads=1):
        """Count the classes."""
        above = patches.height > parameters.height
        counts = [
            np.bincount(patches.label[mask & (patches.label >= 0)], minlength=n_classes) for mask in (~above, above)
        ]
        return cls(parameters.height, np.argmax(counts, axis=1), n_classes)

    def predict_proba(self, patches, edges):
        """Return probability 1 of one class for each patch."""
        return np.eye(self.n_classes)[self.classes[(patches.height > self.height).astype(int)]]

    def to_arrays(self):
        """Return the state."""
        return {"height": np.array(self.height), "classes": self.classes, "n_classes": np.array(self.n_classes)}

    @classmethod
    def from_arrays(cls, arrays):
        """Rebuild the classifier."""
        return cls(float(arrays["height"]), np.asarray(arrays["classes"]), int(arrays["n_classes"]))

"""Labels of a method that knows features and of cameras made into one: the paper's rule, and the pool."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.classes import IGNORE
from mlsroad_pipeline.algorithms.fusion.class_preference import ClassPreference
from mlsroad_pipeline.algorithms.fusion.log_linear_pool import LogLinearPool, PoolParameters


def spread_confidence(
    labels: NDArray[np.integer], confidence: NDArray[np.floating], n_classes: int
) -> NDArray[np.float32]:
    """Return probabilities of all classes of a labeller that tells the best class and its probability.

    Parameters
    ----------
    labels : ndarray of shape (n,), int
        Labels, -1 for none.
    confidence : ndarray of shape (n,), float
        Probability of the label.
    n_classes : int
        Number of classes, at least 2.

    Returns
    -------
    ndarray of shape (n, n_classes), float32
        The confidence for the label, the rest evenly for the others; NaN for points without a label.
    """
    rest = (1 - confidence.astype(np.float32)) / np.float32(n_classes - 1)
    out = np.repeat(rest[:, None], n_classes, axis=1)
    known = labels != IGNORE
    out[known, labels[known]] = confidence[known]
    out[~known] = np.nan
    return out


def camera_labels(cameras: NDArray[np.floating]) -> NDArray[np.int16]:
    """Return the most probable class by each camera.

    Parameters
    ----------
    cameras : ndarray of shape (groups, n, classes), float
        Probabilities by each camera; NaN where it does not see the point.

    Returns
    -------
    ndarray of shape (groups, n), int16
        Labels, -1 where the camera does not see the point.
    """
    best = np.nan_to_num(cameras).argmax(axis=2)
    return np.where(np.isnan(cameras[:, :, 0]), IGNORE, best).astype(np.int16)


@dataclass(frozen=True)
class FusedLabels:
    """What both fusions make of points.

    Parameters
    ----------
    images : ndarray of shape (n,), int16
        The choice among the cameras, -1 where none sees the point.
    rule, pool : ndarray of shape (n,), int16
        Labels by class preference and by the pool.
    probabilities : ndarray of shape (n, classes), float64
        Of the pool.
    """

    images: NDArray[np.int16]
    rule: NDArray[np.int16]
    pool: NDArray[np.int16]
    probabilities: NDArray[np.float64]


@dataclass(frozen=True)
class TwoMethodFusion:
    """Which camera and which method to believe, learned on test set 1 (Tomic et al. 2019, sections 2.3 and 3.3).

    Parameters
    ----------
    cameras : ClassPreference
        Among the cameras.
    methods : ClassPreference
        Between the method that knows features (first) and the images.
    pool : LogLinearPool
        Of the first method and all cameras.
    """

    cameras: ClassPreference
    methods: ClassPreference
    pool: LogLinearPool

    @classmethod
    def fit(
        cls, labels: NDArray[np.integer], confidence: NDArray[np.floating], cameras: NDArray[np.floating],
        reference: NDArray[np.integer], *, pool: PoolParameters | None = None,
    ) -> TwoMethodFusion:  # fmt: skip
        """Learn on test set 1.

        Parameters
        ----------
        labels : ndarray of shape (n,), int
            Labels of the method that knows features, -1 for none.
        confidence : ndarray of shape (n,), float
            Their probabilities.
        cameras : ndarray of shape (groups, n, classes), float
            Probabilities by each camera; NaN where it does not see the point.
        reference : ndarray of shape (n,), int
            True labels; points labelled -1 are ignored.
        pool : PoolParameters, optional
            Of the probabilistic fusion.

        Returns
        -------
        TwoMethodFusion
            What was learned.

        Raises
        ------
        DataError
            If shapes differ or no point is labelled.
        """
        n_classes = cameras.shape[2]
        given = camera_labels(cameras)
        among = ClassPreference.fit(list(given), reference, n_classes=n_classes)
        images, _ = among.fuse(list(given))
        both = (images != IGNORE) & (labels != IGNORE)
        methods = ClassPreference.fit([labels[both], images[both]], reference[both], n_classes=n_classes)
        tables = [spread_confidence(labels, confidence, n_classes), *cameras]
        return cls(among, methods, LogLinearPool.fit(tables, reference, parameters=pool))

    def fuse(
        self, labels: NDArray[np.integer], confidence: NDArray[np.floating], cameras: NDArray[np.floating]
    ) -> FusedLabels:
        """Make one label of those of the method and the cameras.

        Parameters
        ----------
        labels : ndarray of shape (n,), int
            Labels of the method that knows features, -1 for none.
        confidence : ndarray of shape (n,), float
            Their probabilities.
        cameras : ndarray of shape (groups, n, classes), float
            Probabilities by each camera; NaN where it does not see the point.

        Returns
        -------
        FusedLabels
            The labels.

        Raises
        ------
        DataError
            If the number of cameras or classes is another than on test set 1.
        """
        images, _ = self.cameras.fuse(list(camera_labels(cameras)))
        rule, _ = self.methods.fuse([labels, images])
        tables = [spread_confidence(labels, confidence, cameras.shape[2]), *cameras]
        probabilities = self.pool.predict_proba(tables)
        return FusedLabels(images, rule, probabilities.argmax(axis=1).astype(np.int16), probabilities)

    def to_arrays(self) -> dict[str, NDArray]:
        """Return what was learned as arrays, for files that hold no code.

        Returns
        -------
        dict of str to ndarray
            F1 of cameras and methods, and the parameters of the pool.
        """
        return {
            "camera_f1": self.cameras.f1,
            "method_f1": self.methods.f1,
            "bias": self.pool.bias,
            "weights": self.pool.weights,
            "offsets": self.pool.offsets,
            "floor": np.array([self.pool.floor]),
        }

    @classmethod
    def from_arrays(cls, arrays: dict[str, NDArray]) -> TwoMethodFusion:
        """Build it from the arrays of `to_arrays`.

        Parameters
        ----------
        arrays : mapping of str to ndarray
            What was learned.

        Returns
        -------
        TwoMethodFusion
            The same fusion.
        """
        pool = LogLinearPool(arrays["bias"], arrays["weights"], arrays["offsets"], float(arrays["floor"][0]))
        return cls(ClassPreference(arrays["camera_f1"]), ClassPreference(arrays["method_f1"]), pool)

"""What all methods that recognise objects share: sets of objects with classes, and the protocol."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.features.accumulation_images import join_objects, join_values


class Recogniser(Protocol):
    """A method that tells what an object is from its points."""

    def fit(
        self, objects: Sequence[ArrayLike], classes: ArrayLike, *, intensities: Sequence[ArrayLike] | None = None
    ) -> Self:
        """Learn from objects and their classes.

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
        Recogniser
            Itself.
        """
        ...

    def predict_proba(
        self, objects: Sequence[ArrayLike], *, intensities: Sequence[ArrayLike] | None = None
    ) -> NDArray[np.float64]:
        """Return the probability of each class, columns in the order of the sorted classes.

        Parameters
        ----------
        objects : sequence of array-like of shape (n_i, 3)
            Points of each object, metres, z up.
        intensities : sequence of array-like of shape (n_i,), optional
            Intensity of each point in [0, 1].

        Returns
        -------
        ndarray of float64, shape (objects, classes)
            Probabilities.
        """
        ...

    def to_arrays(self) -> dict[str, NDArray]:
        """Return what was learned as plain arrays."""
        ...


@dataclass(frozen=True)
class ObjectSet:
    """Objects with their classes, joined into flat arrays.

    Parameters
    ----------
    xyz : ndarray of float64, shape (n, 3)
        Points, object by object, metres.
    indptr : ndarray of int64, shape (objects + 1,)
        Where the points of each object begin.
    label : ndarray of int16, shape (objects,)
        Class of each object, -1 for unknown.
    intensity : ndarray of float32, shape (n,), or None
        Intensity of each point in [0, 1].

    Raises
    ------
    DataError
        If the arrays do not fit each other.
    """

    xyz: NDArray[np.float64]
    indptr: NDArray[np.int64]
    label: NDArray[np.int16]
    intensity: NDArray[np.float32] | None = None

    def __post_init__(self) -> None:
        bad = self.intensity is not None and len(self.intensity) != len(self.xyz)
        if len(self.label) != len(self.indptr) - 1 or self.indptr[-1] != len(self.xyz) or bad:
            raise DataError(
                f"{len(self.label)} classes and {len(self.xyz)} points for {len(self.indptr) - 1} objects of "
                f"{int(self.indptr[-1])} points"
            )

    @classmethod
    def from_objects(
        cls, objects: Sequence[ArrayLike], label: ArrayLike, intensities: Sequence[ArrayLike] | None = None
    ) -> Self:
        """Join objects.

        Parameters
        ----------
        objects : sequence of array-like of shape (n_i, 3)
            Points of each object.
        label : array-like of int, shape (objects,)
            Class of each.
        intensities : sequence of array-like of shape (n_i,), optional
            Intensity of each point.

        Returns
        -------
        ObjectSet
            The set.

        Raises
        ------
        DataError
            If an object is empty or not finite, or there is not one class per object.
        """
        xyz, indptr = join_objects(objects)
        intensity = None if intensities is None else join_values(intensities, indptr, "intensities")
        return cls(
            xyz,
            indptr,
            np.asarray(label, dtype=np.int16),
            None if intensity is None else intensity.astype(np.float32),
        )

    @classmethod
    def join(cls, sets: Sequence[Self]) -> Self:
        """Join sets; intensity is kept where all have it.

        Parameters
        ----------
        sets : sequence of ObjectSet
            At least one set.

        Returns
        -------
        ObjectSet
            All objects in the order of the sets.

        Raises
        ------
        DataError
            If there is no set.
        """
        if not sets:
            raise DataError("there are no sets of objects to join")
        counts = np.concatenate([np.diff(part.indptr) for part in sets])
        every = [part.intensity for part in sets if part.intensity is not None]
        return cls(
            np.concatenate([part.xyz for part in sets]),
            np.append(0, np.cumsum(counts)).astype(np.int64),
            np.concatenate([part.label for part in sets]),
            np.concatenate(every) if len(every) == len(sets) else None,
        )

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray]) -> Self:
        """Build a set from what `to_arrays` gave.

        Parameters
        ----------
        arrays : mapping of str to ndarray
            The arrays.

        Returns
        -------
        ObjectSet
            The set.
        """
        return cls(arrays["xyz"], arrays["indptr"], arrays["label"], arrays.get("intensity"))

    def to_arrays(self) -> dict[str, NDArray]:
        """Return the set as plain arrays; without ``intensity`` where there is none."""
        arrays: dict[str, NDArray] = {"xyz": self.xyz, "indptr": self.indptr, "label": self.label}
        return arrays if self.intensity is None else {**arrays, "intensity": self.intensity}

    def __len__(self) -> int:
        """Return the number of objects."""
        return len(self.label)

    @property
    def objects(self) -> list[NDArray[np.float64]]:
        """Return the points of each object."""
        return np.split(self.xyz, self.indptr[1:-1]) if len(self) else []

    @property
    def intensities(self) -> list[NDArray[np.float32]] | None:
        """Return the intensities of each object's points."""
        if self.intensity is None:
            return None
        return np.split(self.intensity, self.indptr[1:-1]) if len(self) else []

    def take(self, rows: ArrayLike) -> ObjectSet:
        """Take some objects.

        Parameters
        ----------
        rows : array-like of int or bool
            The objects, in the order that is wanted.

        Returns
        -------
        ObjectSet
            They alone.
        """
        chosen = np.arange(len(self))[np.asarray(rows)]
        counts = np.diff(self.indptr)[chosen]
        indptr = np.append(0, np.cumsum(counts)).astype(np.int64)
        points = np.repeat(self.indptr[chosen] - indptr[:-1], counts) + np.arange(indptr[-1])
        intensity = None if self.intensity is None else self.intensity[points]
        return ObjectSet(self.xyz[points], indptr, self.label[chosen], intensity)


def check_training(
    objects: Sequence[ArrayLike], classes: ArrayLike, *, method: str
) -> tuple[NDArray, NDArray[np.int64]]:
    """Check that there is something to learn, and number the classes.

    Parameters
    ----------
    objects : sequence of array-like
        The objects.
    classes : array-like of shape (objects,)
        Their classes.
    method : str
        What messages call the method.

    Returns
    -------
    classes : ndarray
        The classes that occur, sorted.
    target : ndarray of int64, shape (objects,)
        The place of each object's class among them.

    Raises
    ------
    DataError
        If there is not one class per object, or fewer than two classes.
    """
    given = np.asarray(classes)
    if given.shape != (len(objects),):
        raise DataError(f"{method}: classes must have shape ({len(objects)},), got {given.shape}")
    found, target = np.unique(given, return_inverse=True)
    if len(found) < 2:
        raise DataError(f"{method} needs objects of at least two classes, got {found.tolist()} alone")
    return found, target.astype(np.int64)

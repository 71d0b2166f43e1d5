"""Legend of segmented images or labelled points: what class numbers mean, and which classes of points they give."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.cameras.cityscapes import SKY
from mlsroad_pipeline.algorithms.core.classes import IGNORE, TAXONOMY, ClassScheme
from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError

LARGEST_NUMBER = 65535
"""Largest class number of a mask."""


@dataclass(frozen=True)
class Legend:
    """Classes of segmented images, or of labelled points from elsewhere."""

    # Class numbers, ascending. Score k of a network or of a file of probabilities belongs to the number k.
    numbers: tuple[int, ...]
    names: tuple[str, ...]  # Name of each
    # Class of points that each gives: a class of a scheme or of the taxonomy; None for pixels that give no class, such
    # as the sky
    classes: tuple[str | None, ...]
    source: str = "classes"  # Name of the legend in messages

    def __post_init__(self) -> None:
        if not self.numbers:
            raise ParameterError(f"{self.source}: names no classes")
        for number in self.numbers:
            if not 0 <= number <= LARGEST_NUMBER:
                raise ParameterError(f"{self.source}: class number {number} is not in 0 to {LARGEST_NUMBER}")
        if list(self.numbers) != sorted(set(self.numbers)):
            repeated = next((n for n in self.numbers if self.numbers.count(n) > 1), self.numbers[0])
            raise ParameterError(f"{self.source}: class number {repeated} is repeated or out of order")

    @classmethod
    def of_rows(cls, rows: Sequence[tuple[int, str, str | None]], source: str) -> Self:
        """Build a legend."""
        numbers, names, classes = zip(*sorted(rows, key=lambda row: row[0]), strict=True) if rows else ((), (), ())
        return cls(numbers, names, classes, source)

    @classmethod
    def of_scheme(cls, scheme: ClassScheme) -> Self:
        """Return the legend of a network of this package: the classes of a scheme and the sky."""
        rows = [(label, name, name) for label, name in enumerate(scheme.classes)]
        return cls.of_rows([*rows, (len(scheme), SKY, None)], f"scheme {scheme.name!r}")

    @classmethod
    def from_json(cls, stored: Mapping[str, Any]) -> Self:
        """Rebuild a legend from `to_json`."""
        return cls.of_rows([(int(n), str(name), given) for n, name, given in stored["rows"]], str(stored["source"]))

    def to_json(self) -> dict[str, Any]:
        """Return the legend as JSON values."""
        rows = zip(self.numbers, self.names, self.classes, strict=True)
        return {"source": self.source, "rows": [list(row) for row in rows]}

    @property
    def n_scores(self) -> int:
        """Number of class numbers from 0 without a gap: the scores that a network can have."""
        return next((k for k, number in enumerate(self.numbers) if number != k), len(self.numbers))

    def labels(self, scheme: ClassScheme) -> NDArray[np.int16]:
        """Return the label of each class number in a scheme."""
        return np.array([self._label(name, scheme) for name in self.classes], dtype=np.int16)

    def _label(self, name: str | None, scheme: ClassScheme) -> int:
        if name is None:
            return IGNORE
        if name in scheme.classes:
            return scheme.classes.index(name)
        if name not in TAXONOMY:
            raise ParameterError(
                f"{self.source}: {name!r} is neither a class of scheme {scheme.name!r} nor of the taxonomy"
            )
        return int(scheme.encode([TAXONOMY[name]], source=self.source)[0])

    def places(self, numbers: NDArray[np.integer], *, source: str, unit: str = "points") -> NDArray[np.intp]:
        """Return the index of each class number in the legend; DataError names the least one that it lacks."""
        place = np.searchsorted(self.numbers, numbers).clip(max=len(self.numbers) - 1)
        wrong = np.asarray(self.numbers)[place] != numbers
        if wrong.any():
            first = int(np.asarray(numbers)[wrong].min())
            count = int((numbers == first).sum())
            unknown = f"class number {first} ({count} {unit}) is not in {self.source}"
            raise DataError(f"{source}: {unknown}: name a class map with it")
        return place

    def of_numbers(self, numbers: NDArray[np.integer], scheme: ClassScheme, *, source: str) -> NDArray[np.float32]:
        """Return the class probabilities of pixels with class numbers."""
        return self._rows_of(scheme)[self.places(numbers, source=source, unit="pixels")]

    def _rows_of(self, scheme: ClassScheme) -> NDArray[np.float32]:
        labels = self.labels(scheme)
        rows = np.full((len(labels), len(scheme)), np.nan, dtype=np.float32)
        rows[labels != IGNORE] = 0
        rows[labels != IGNORE, labels[labels != IGNORE]] = 1
        return rows

    def of_scores(self, scores: NDArray[np.floating], scheme: ClassScheme, *, source: str) -> NDArray[np.float32]:
        """Return the class probabilities of rows of pixels with a probability for each class of the legend."""
        count = scores.shape[2]
        if count != self.n_scores:
            raise DataError(f"{source}: has {count} classes, {self.source} names {self.n_scores} from 0")
        out = np.zeros((*scores.shape[:2], len(scheme)), dtype=np.float32)
        for k, label in enumerate(self.labels(scheme)[:count]):
            if label != IGNORE:
                out[:, :, label] += scores[:, :, k]
        total = out.sum(axis=2, keepdims=True)
        return np.divide(out, total, out=np.full_like(out, np.nan), where=total > 1e-6)

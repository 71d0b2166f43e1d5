"""Sets of objects with classes, in memory and in folders of point files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NotRequired, Self, TypedDict

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.core.exceptions import DataError, ReadError, UnknownClassError
from mlsroad_pipeline.algorithms.features.accumulation_images import concatenate_objects, concatenate_values
from mlsroad_pipeline.formats.base import ReadOptions
from mlsroad_pipeline.formats.registry import get_format
from mlsroad_pipeline.formats.sydney import object_class


class ObjectArrays(TypedDict):
    """Arrays of an `ObjectSet`, as they are stored; without ``intensity`` if it is unknown."""

    xyz: NDArray[np.float64]
    indptr: NDArray[np.int64]
    label: NDArray[np.int16]
    intensity: NotRequired[NDArray[np.float32]]


@dataclass(frozen=True)
class ObjectSet:
    """Objects with their classes, concatenated into flat arrays."""

    xyz: NDArray[np.float64]  # Points, object by object, metres
    indptr: NDArray[np.int64]  # Start of the points of each object; the last entry is n
    label: NDArray[np.int16]  # Class of each object, -1 for unknown
    intensity: NDArray[np.float32] | None = None  # Intensity of each point in [0, 1]

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
        """Build a set from lists of points."""
        xyz, indptr = concatenate_objects(objects)
        intensity = None if intensities is None else concatenate_values(intensities, indptr, "intensities")
        return cls(
            xyz,
            indptr,
            np.asarray(label, dtype=np.int16),
            None if intensity is None else intensity.astype(np.float32),
        )

    @classmethod
    def join(cls, sets: Sequence[Self]) -> Self:
        """Concatenate sets; intensity is kept if all sets have it."""
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
    def from_arrays(cls, arrays: ObjectArrays) -> Self:
        """Build a set from the arrays of `to_arrays`."""
        return cls(arrays["xyz"], arrays["indptr"], arrays["label"], arrays.get("intensity"))

    def to_arrays(self) -> ObjectArrays:
        """Return the set as plain arrays; without ``intensity`` if it is unknown."""
        arrays: ObjectArrays = {"xyz": self.xyz, "indptr": self.indptr, "label": self.label}
        if self.intensity is not None:
            arrays["intensity"] = self.intensity
        return arrays

    def __len__(self) -> int:
        """Return the number of objects."""
        return len(self.label)

    @property
    def objects(self) -> list[NDArray[np.float64]]:
        """Return the points of each object."""
        return np.split(self.xyz, self.indptr[1:-1]) if len(self) else []

    @property
    def intensities(self) -> list[NDArray[np.float32]] | None:
        """Return the intensities of the points of each object."""
        if self.intensity is None:
            return None
        return np.split(self.intensity, self.indptr[1:-1]) if len(self) else []

    def take(self, rows: ArrayLike) -> ObjectSet:
        """Return a subset of the objects."""
        chosen = np.arange(len(self))[np.asarray(rows)]
        counts = np.diff(self.indptr)[chosen]
        indptr = np.append(0, np.cumsum(counts)).astype(np.int64)
        points = np.repeat(self.indptr[chosen] - indptr[:-1], counts) + np.arange(indptr[-1])
        intensity = None if self.intensity is None else self.intensity[points]
        return ObjectSet(self.xyz[points], indptr, self.label[chosen], intensity)


def check_training(
    objects: Sequence[ArrayLike], classes: ArrayLike, *, method: str
) -> tuple[NDArray, NDArray[np.int64]]:
    """Validate training data and number the classes."""
    values = np.asarray(classes)
    if values.shape != (len(objects),):
        raise DataError(f"{method}: classes must have shape ({len(objects)},), got {values.shape}")
    present, target = np.unique(values, return_inverse=True)
    if len(present) < 2:
        raise DataError(f"{method} needs objects of at least two classes, got {present.tolist()} alone")
    return present, target.astype(np.int64)


def find_folds(root: str | Path, pattern: str) -> dict[str, Path]:
    """Return the list file of each fold by its name."""
    folds = {path.stem: path for path in sorted(Path(root).glob(pattern))}
    if len(folds) < 2:
        raise ReadError(f"{root} has {len(folds)} files {pattern}: at least two folds are needed")
    return folds


def listed_files(path: Path) -> list[Path]:
    """Return the files of a list, from its folder or a sibling folder."""
    names = [line.strip() for line in path.read_text(encoding="utf-8").splitlines() if line.strip()]
    if not names:
        raise ReadError(f"{path} lists no files")
    folders = [path.parent, *sorted(folder for folder in path.parent.parent.iterdir() if folder.is_dir())]
    files = []
    for name in names:
        place = next((folder / name for folder in folders if (folder / name).is_file()), None)
        if place is None:
            raise ReadError(f"{path} lists {name}, which is not in {', '.join(str(folder) for folder in folders)}")
        files.append(place)
    return files


def read_fold(path: str, files: Sequence[str], *, scheme: ClassScheme) -> ObjectArrays:
    """Return the objects of a fold; the class is the first part of a file name."""
    objects, labels, intensities = [], [], []
    for file in map(Path, files):
        name = object_class(file)
        if name not in scheme.classes:
            raise UnknownClassError(f"{path}: {file}: class scheme {scheme.name!r} has no class {name!r}")
        cloud = get_format(file).read(file, ReadOptions())
        objects.append(cloud.xyz)
        intensities.append(cloud["intensity"])
        labels.append(scheme.classes.index(name))
    return ObjectSet.from_objects(objects, np.array(labels), intensities).to_arrays()

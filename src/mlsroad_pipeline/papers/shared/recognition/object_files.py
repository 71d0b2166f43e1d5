"""Objects in one file each, listed by fold, as in the Sydney Urban Objects dataset."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.core.exceptions import ReadError, UnknownClassError
from mlsroad_pipeline.formats.options import ReadOptions
from mlsroad_pipeline.formats.registry import get_format
from mlsroad_pipeline.formats.sydney import object_class
from mlsroad_pipeline.papers.shared.recognition.object_set import ObjectArrays, ObjectSet


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

"""Classes that a survey comes with: kept classes of its own files, and predictions in files beside them."""

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.cameras.legend import Legend
from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.core.codings import NOISE_CODES
from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError, ReadError
from mlsroad_pipeline.algorithms.core.plain_text import printable, shortened
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.formats.base import ReadOptions
from mlsroad_pipeline.formats.kitti import read_labels
from mlsroad_pipeline.formats.registry import get_format
from mlsroad_pipeline.surveys.class_map_files import read_class_map
from mlsroad_pipeline.surveys.masks import DAMAGED

KEPT, PREDICTED, CONFIDENCE, PROBABILITIES = "kept", "predicted", "predicted_confidence", "predicted_probabilities"
"""Columns of pieces: class number in the file or -1; predicted class number, its confidence, probabilities."""

CLASS_COLUMNS = ("classification", "label")
"""Columns of a file with its classes, the first that it has."""

SUFFIXES = (".laz", ".las", ".npy", ".npz", ".label")
"""Endings of files of predictions."""
_CLASS_MAPS = {".laz": "asprs", ".las": "asprs", ".label": "semantickitti"}
_ARRAYS = ("probabilities", "labels", "classes")  # of an NPZ with several
_TOLERANCE = 0.01
FIT = "fit"
"""Weight that is fitted on the points of the survey that have a class."""


@dataclass(frozen=True)
class GivenParameters:
    """Parameters `label.given`."""

    keep_classes: bool = False  # Whether points keep the class that they have in the files of the survey
    keep: tuple[int, ...] | None = None  # Class numbers that are kept; None keeps all but those without a class
    classes: str = "asprs"  # Class map of the files of the survey: a shipped one, a coding, or a CSV or YAML file
    labels: str | None = None  # Folder with a file of predictions per cloud
    labels_classes: str | None = None  # Class map of the predictions; None is that of their format
    # Weight of the predictions in a pool with a model, 0 to 1, or `FIT`; None uses no model
    weight: float | str | None = None

    @classmethod
    def from_config(cls, given: Mapping[str, Any]) -> Self:
        """Build the parameters; ParameterError for an unknown name or a wrong value."""
        unknown = [name for name in given if name not in cls.__dataclass_fields__]
        if unknown:
            known = ", ".join(cls.__dataclass_fields__)
            raise ParameterError(f"label.given has no parameter {unknown[0]!r} (parameters: {known})")
        fits = given.get("weight") == FIT
        for name, needed in (("classes", "keep_classes"), ("labels_classes", "labels")):
            if given.get(name) is not None and not given.get(needed) and not (fits and name == "classes"):
                raise ParameterError(f"label.given.{name} has no effect: set label.given.{needed} too")
        keep = given.get("keep")
        return cls(**{**given, "keep": None if keep is None else _codes(keep)})

    def __post_init__(self) -> None:
        if not isinstance(self.keep_classes, bool):
            raise ParameterError(f"label.given.keep_classes must be true or false, got {self.keep_classes!r}")
        if self.keep is not None and not self.keep_classes:
            raise ParameterError("label.given.keep chooses among kept classes: set label.given.keep_classes=true")
        for name in ("classes", "labels", "labels_classes"):
            if not isinstance(getattr(self, name), str | None):
                raise ParameterError(f"label.given.{name} must be a text, got {getattr(self, name)!r}")
        weight = 0.5 if self.weight in (None, FIT) else self.weight
        if isinstance(weight, bool) or not isinstance(weight, int | float) or not 0 < weight < 1:
            raise ParameterError(
                f"label.given.weight must be a number between 0 and 1, got {self.weight!r}; {FIT} fits it"
            )
        if self.weight is not None and self.labels is None:
            raise ParameterError("label.given.weight is that of predictions: set label.given.labels to their folder")

    @property
    def in_use(self) -> bool:
        """Whether the survey comes with any classes."""
        return self.keep_classes or self.labels is not None

    @property
    def noise(self) -> tuple[int, ...]:
        """Codes of noise whose points are not used; a class map of kept classes gives other meanings to numbers."""
        if not self.keep_classes:
            return NOISE_CODES
        if self.classes != "asprs" or self.keep is None:
            return ()
        return tuple(code for code in NOISE_CODES if code not in self.keep)

    def check_class_maps(self, scheme: ClassScheme, codings: Mapping[str, Any]) -> None:
        """Raise ReadError for a class map that cannot be read, before the survey is."""
        for name, given in (("classes", self.classes), ("labels_classes", self.labels_classes)):
            if given is not None and (self.keep_classes or self.weight == FIT or name != "classes"):
                with suppress(ParameterError):  # it may name classes of the scheme of a model, which is not known yet
                    read_class_map(given, scheme, option=f"label.given.{name}", codings=codings)

    def kept_legend(self, scheme: ClassScheme, codings: Mapping[str, Any]) -> Legend | None:
        """Return the class map of the kept classes; None where none is kept."""
        if not self.keep_classes:
            return None
        legend = read_class_map(self.classes, scheme, option="label.given.classes", codings=codings)
        missing = [number for number in self.keep or () if number not in legend.numbers]
        if missing:
            raise ParameterError(f"label.given.keep: class number {missing[0]} is not in class map {legend.source}")
        return legend

    def predicted_legend(self, scheme: ClassScheme, codings: Mapping[str, Any], suffixes: set[str]) -> Legend | None:
        """Return the class map of predictions in files with some endings; None without predictions."""
        if self.labels is None:
            return None
        names = {self.labels_classes or _CLASS_MAPS.get(suffix) for suffix in suffixes}
        if len(names) != 1 or None in names:
            raise ParameterError(
                f"label.given.labels_classes is not set: name the class map of {self.labels} ({', '.join(suffixes)})"
            )
        return read_class_map(str(names.pop()), scheme, option="label.given.labels_classes", codings=codings)


def _codes(given: Any) -> tuple[int, ...]:
    items = given.split(",") if isinstance(given, str) else given if isinstance(given, list | tuple) else [given]
    try:
        return tuple(sorted({int(str(item)) for item in items}))
    except ValueError:
        raise ParameterError(f"label.given.keep must list class numbers, such as 2,6,7; got {given!r}") from None


def prediction_file(folder: str, name: str) -> str:
    """Return the file of predictions of a cloud: with its name below the folder, and another ending."""
    root = Path(folder).expanduser()
    if not root.is_dir():
        raise ReadError(f"{root} is not a folder (label.given.labels)")
    whole = PurePosixPath(name)
    stem = PurePosixPath(whole.name.removesuffix(".gz")).stem.removesuffix(".copc")
    names = (stem, f"{stem}_pred", whole.name)
    folders = (root / whole.parent, root)
    places = [place / f"{own}{suffix}" for place in folders for own in names for suffix in SUFFIXES]
    found = next((place for place in places if place.is_file()), None)
    if found is None:
        raise ReadError(f"{root}: no labels of {name}: neither {stem}.npy nor one with {', '.join(SUFFIXES)}")
    return str(found)


def given_columns(
    cloud: PointCloud, given: GivenParameters, predictions: str | None, *, path: str, start: int, n_total: int
) -> dict[str, NDArray]:
    """Return the columns of the given classes of a range of a file."""
    columns: dict[str, NDArray] = {}
    if given.keep_classes or given.weight == FIT:
        own = next((cloud[name] for name in CLASS_COLUMNS if name in cloud), None)
        if own is None:
            what = "to keep (label.given.keep_classes)" if given.keep_classes else "to fit label.given.weight on"
            raise DataError(f"{path} has no column of classes {what}")
        numbers = np.asarray(own).astype(np.int32)
        columns[KEPT] = numbers if given.keep is None else np.where(np.isin(numbers, given.keep), numbers, -1)
    if predictions is not None:
        columns |= read_predictions(Path(predictions), start, start + len(cloud), n_total, path)
    return columns


def read_predictions(source: Path, start: int, stop: int, n_total: int, cloud: str) -> dict[str, NDArray]:
    """Return the columns of rows `start` to `stop` of a file of predictions; `cloud` has `n_total` points."""
    suffix = source.suffix.lower()
    if suffix == ".label":
        return {PREDICTED: read_labels(source, n_total, Path(cloud))[start:stop].astype(np.int32)}
    if suffix in (".laz", ".las"):
        return _of_las(source, start, stop, n_total, cloud)
    values = _array(source)
    flat = values.ndim == 2 and values.shape[1] == 1
    values = values[:, 0] if flat else values
    if values.ndim not in (1, 2):
        raise ReadError(f"{source}: shape {values.shape}; class numbers have (n,), probabilities (n, classes)")
    _check_length(source, len(values), n_total, cloud)
    rows = np.array(values[start:stop])
    if values.ndim == 2:
        return {PROBABILITIES: _checked(rows, source, start)}
    if rows.dtype.kind not in "iu":
        whole = rows.dtype.kind == "f" and bool((rows == np.rint(rows)).all())
        if not whole:
            raise ReadError(f"{source}: class numbers are {rows.dtype}, not whole numbers")
    return {PREDICTED: rows.astype(np.int32)}


def _of_las(source: Path, start: int, stop: int, n_total: int, cloud: str) -> dict[str, NDArray]:
    form = get_format(source)
    info = form.info(source, ReadOptions())
    _check_length(source, info.n_points, n_total, cloud)
    names = tuple(name for name in ("classification", "confidence") if name in info.columns)
    read = form.read(source, ReadOptions(only=names), start=start, stop=stop)
    columns = {PREDICTED: read["classification"].astype(np.int32)}
    if "confidence" in read:
        columns[CONFIDENCE] = np.clip(np.nan_to_num(read["confidence"]), 0, 1).astype(np.float32)
    return columns


def _check_length(source: Path, count: int, n_total: int, cloud: str) -> None:
    if count != n_total:
        raise ReadError(f"{source} has {count} labels for the {n_total} points of {cloud}")


def _array(source: Path) -> NDArray:
    """Return the array of an NPY file, not read into memory, or of an NPZ file."""
    try:
        if source.suffix.lower() == ".npy":
            values: NDArray = np.load(source, mmap_mode="r", allow_pickle=False)
            return values
        with np.load(source, allow_pickle=False) as archive:
            names = archive.files if len(archive.files) == 1 else [name for name in _ARRAYS if name in archive.files]
            if not names:
                raise ReadError(f"{source} has arrays {', '.join(archive.files)}: name one {' or '.join(_ARRAYS)}")
            chosen: NDArray = archive[names[0]]
            return chosen
    except ReadError:
        raise
    except DAMAGED as error:
        message = f"{type(error).__name__}: {shortened(printable(error), 200)}"
        raise ReadError(f"{source}: cannot be read as {source.suffix[1:].upper()}: {message}") from error


def _checked(rows: NDArray, source: Path, start: int) -> NDArray[np.float32]:
    """Return probabilities as float32; ReadError names the first row that is none."""
    if rows.dtype.kind != "f":
        raise ReadError(f"{source}: probabilities are {rows.dtype}, not floats")
    total = rows.sum(axis=1, dtype=np.float64)
    wrong = np.flatnonzero(~((np.abs(total - 1) <= _TOLERANCE) & (rows.min(axis=1) >= 0)))
    if len(wrong):
        first = int(wrong[0])
        raise ReadError(
            f"{source}: the probabilities of row {start + first} sum to {total[first]:.4g} with minimum "
            f"{rows[first].min():.4g} ({len(wrong)} rows); they must be >= 0 and sum to 1"
        )
    return rows.astype(np.float32)

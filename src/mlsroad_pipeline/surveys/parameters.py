"""Parameters of the survey of a comparison and of a survey to label."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mlsroad_pipeline.algorithms.core.codings import Coding
from mlsroad_pipeline.algorithms.core.exceptions import ParameterError, ReadError
from mlsroad_pipeline.algorithms.core.validation import check_positive
from mlsroad_pipeline.algorithms.inventory.lines.kerbs.kerb_lines import LEAST_LENGTH, StepLimits
from mlsroad_pipeline.algorithms.inventory.lines.markings import marking_lines
from mlsroad_pipeline.algorithms.inventory.objects.rules import KINDS
from mlsroad_pipeline.algorithms.models.given_labels.labeller import SLUG as GIVEN_LABELS
from mlsroad_pipeline.formats.base import NEW_SURVEY, TAXONOMY_CODING, ReadOptions
from mlsroad_pipeline.formats.crs import parse_crs
from mlsroad_pipeline.surveys.given_classes import GivenParameters


@dataclass(frozen=True)
class SurveyParameters:
    """The survey of a comparison."""

    root: str  # Folder of the survey
    # Split name to a glob, a list of globs, or ``{files, along, sectors, gap}``; None removes a split of the base
    # configuration
    splits: Mapping[str, Any]
    scheme: str  # Class scheme of the training
    evaluation_scheme: str | None = None  # Coarser class scheme of the scores; None takes `scheme`
    coding: str = "taxonomy"  # Meaning of the label codes: a coding of ``parameters_classes.yml``
    trajectory: str | None = None  # Name of the trajectory file beside the points
    read: Mapping[str, Any] = field(default_factory=dict)  # Arguments of `ReadOptions`
    source: str | None = None  # Where the survey can be obtained, for the message when `root` is not a folder

    def __post_init__(self) -> None:
        for name in self.splits:
            if re.fullmatch(r"[A-Za-z0-9_-]+", str(name)) is None:
                raise ParameterError(f"the name of a split has only letters, digits, '_' and '-', got {name!r}")

    def check_root(self) -> None:
        """Check that the root is a folder."""
        if not Path(str(self.root)).is_dir():
            where = f"; the data are available from {self.source}" if self.source else ""
            raise ReadError(f"{self.root} is not a folder (survey.root){where}")

    def options(self, codings: Mapping[str, Mapping[int, str] | None]) -> ReadOptions:
        """Return the options of the readers."""
        if self.coding not in codings:
            raise ParameterError(f"survey.coding {self.coding!r} is not configured (codings: {', '.join(codings)})")
        codes = codings[self.coding]
        coding = TAXONOMY_CODING if codes is None else Coding.from_config(self.coding, codes)
        return ReadOptions.from_config({**self.read, "coding": coding})


LEAST_SCORES = {"pole": 0.3, "sign": 0.4, "vehicle": 0.4, "tree": 0.4}
"""Least score of a listed object of a kind that `label.least_score` does not name: best F on simulated streets and
known blocks of Oakland."""

EXPORT_FORMATS = ("csv", "geojson", "flatgeobuf", "shapefile", "gml", "dxf")
"""Formats of `label.export`."""


def _formats(given: object) -> tuple[str, ...]:
    """Return the formats of `label.export` in the order of `EXPORT_FORMATS`."""
    if not isinstance(given, str | Sequence | None) or isinstance(given, bytes):
        raise ParameterError(f"label.export must be a list of formats ({', '.join(EXPORT_FORMATS)}), got {given!r}")
    names = [part for item in ([given] if isinstance(given, str) else given or ()) for part in str(item).split(",")]
    named = {name.strip().lower() for name in names} - {""}
    unknown = sorted(named - set(EXPORT_FORMATS))
    if unknown:
        raise ParameterError(f"unknown format {unknown[0]!r} in label.export (known: {', '.join(EXPORT_FORMATS)})")
    return tuple(name for name in EXPORT_FORMATS if name in named)


_KINDS: dict[str, tuple[Any, str]] = {
    **dict.fromkeys(
        ("align_passes", "copc", "coloured_ply", "photos", "overwrite", "keep_state"), (bool, "be true or false")
    ),
    "join_drives": (bool | None, "be true, false or null"),
    **dict.fromkeys(("trajectory", "images", "sections", "keys_from"), (str | Path | None, "be the name of a file")),
    **dict.fromkeys(("read", "inventory", "given"), (Mapping, "have parameters below it")),
}
"""Parameter of `label` to its type and what a message says of it."""


@dataclass(frozen=True)
class LabelParameters:
    """A survey to label, the model and the outputs."""

    survey: str | Sequence[str]  # File, folder or glob, or several of them
    output: str  # Folder for the results; not a folder of the survey
    method: str | None = None  # Slug of the method; None takes the champion of the registered models or a shipped model
    # Name of a shipped model, version or alias of a registered one, or path of a model's folder
    model: int | str | None = None
    # Codes to write: ``"asprs"``, or a class scheme that the model's classes nest in, as codes from 64
    scheme: str = "asprs"
    trajectory: str | None = "trajectory.csv"  # Name of the trajectory file beside the points
    read: Mapping[str, Any] = field(default_factory=dict)  # Arguments of `ReadOptions`
    inventory: Mapping[str, Any] = field(default_factory=dict)  # Changes of the object rules, by kind or class
    given: Mapping[str, Any] = field(default_factory=dict)  # Arguments of `GivenParameters`
    # Least score of a listed object, 0 to 1, or one per kind. Larger lists fewer objects, of which more are right; 0
    # lists all candidates. A kind that is not named has that of `LEAST_SCORES`.
    least_score: float | Mapping[str, float] = field(default_factory=LEAST_SCORES.copy)
    # Whether an object or a line that several passes (folders of files) recorded is listed once. None does so where all
    # coordinates are farther than 10 km from the origin; those of single scans are of the scanner.
    join_drives: bool | None = None
    # Largest distance of a listed object or line from the path in plan, metres; of a line, that of its nearest vertex.
    # None lists all.
    within: float | None = None
    # Changes of the limits of kerbs: `StepLimits`, and `least_length` in metres. None finds no kerbs.
    kerbs: Mapping[str, Any] | None = field(default_factory=dict)
    # Changes of `least_contrast` (standard deviations of the road) and `least_length` (metres). None finds no markings.
    markings: Mapping[str, Any] | None = field(default_factory=dict)
    # Whether to write a cloud-optimised copy (``.copc.laz``) beside each LAZ, for web viewers and QGIS
    copc: bool = False
    # Whether to write a PLY with class colours beside each LAZ, for viewers without classification colours
    coloured_ply: bool = False
    # Formats of further copies of the inventory, of `EXPORT_FORMATS`; a single text separates them by commas
    export: Sequence[str] = ()
    # CSV file of road sections: `section`, `from_station`, `to_station` in metres along the trajectory. None counts
    # objects per 100 m.
    sections: str | None = None
    # Output folder of an earlier survey of the same street: objects that stand at their place keep its keys
    keys_from: str | None = None
    photos: bool = False  # Whether to write a photo of each object that an image beside the points shows
    # Name of the camera file beside the points, or its path, for methods that use images; see
    # `camera_files.read_images`. None means a survey without images.
    images: str | None = "calibration.json"
    # Coordinate reference system of the survey as WKT or a code ("EPSG:28992"), in place of that of the files;
    # coordinates are not transformed. None keeps that of the files.
    crs: str | None = None
    # Whether files and passes that lie apart where they overlap are labelled as if they lay together: a rigid move per
    # pass. Written points keep their coordinates.
    align_passes: bool = False
    overwrite: bool = False  # Whether results of other runs and edited results in `output` may be replaced
    keep_state: bool = False  # Whether the scene stores of a finished run stay in `output`

    def __post_init__(self) -> None:
        for name, (kind, words) in _KINDS.items():
            if not isinstance(getattr(self, name), kind):
                raise ParameterError(f"label.{name} must {words}, got {getattr(self, name)!r}")
        for name in ("method", "scheme", "crs"):
            if isinstance(getattr(self, name), list | Mapping):
                raise ParameterError(f"label.{name} must be a single value, got {getattr(self, name)!r}")
        self.kerb_limits()
        _ = self.least_contrast, self.least_marking, self.given_classes
        if self.within is not None:
            check_positive(self.within, "label.within")
        object.__setattr__(self, "export", _formats(self.export))
        if self.photos and self.images is None:
            raise ParameterError("label.photos needs images: set label.images to the name of their camera file")
        _ = self.least_scores
        if self.crs is not None:
            parse_crs(str(self.crs), option="label.crs")
            if self.read.get("crs") not in (None, self.crs):
                raise ParameterError(
                    f"label.crs {self.crs!r} and label.read.crs {self.read['crs']!r} differ: give one of them"
                )
        is_folder = "/" in str(self.model) and Path(str(self.model), "model.json").is_file()
        named = self.model is None or re.fullmatch(r"[1-9]\d*|[A-Za-z][\w.-]*", str(self.model)) is not None
        if not named and not is_folder:
            raise ParameterError(
                "label.model must be a version such as 3, an alias, the name of a shipped model, or the path of a "
                f"folder with a model.json; got {self.model!r}"
            )

    def options(self) -> ReadOptions:
        """Return the options of the readers."""
        given = {} if self.crs is None else {"crs": str(self.crs)}
        return ReadOptions.from_config({**NEW_SURVEY, **self.read, **given})

    @property
    def given_classes(self) -> GivenParameters:
        """Classes that the survey comes with."""
        return GivenParameters.from_config(self.given)

    @property
    def needs_no_model(self) -> bool:
        """Whether the classes that the survey comes with are the only ones."""
        given = self.given_classes
        if self.method == GIVEN_LABELS and not given.in_use:
            raise ParameterError(f"label.method {self.method} needs label.given.keep_classes or label.given.labels")
        alone = given.labels is not None and given.weight is None and self.method is None
        return (self.method == GIVEN_LABELS or alone) and self.model is None

    @property
    def least_kerb(self) -> float:
        """Length of the shortest kerb, metres."""
        return check_positive((self.kerbs or {}).get("least_length", LEAST_LENGTH), "label.kerbs.least_length")

    def kerb_limits(self) -> StepLimits | None:
        """Return the limits of a kerb's step; None where no kerbs are wanted."""
        given = self._changes("kerbs", (*StepLimits.__dataclass_fields__, "least_length"))
        _ = self.least_kerb
        if self.kerbs is None:
            return None
        try:
            return StepLimits(**{name: value for name, value in given.items() if name != "least_length"})
        except ParameterError as error:
            raise ParameterError(f"label.kerbs: {error}") from error

    @property
    def least_scores(self) -> dict[str, float]:
        """Least score of a listed object by kind."""
        given = self.least_score
        named = given if isinstance(given, Mapping) else dict.fromkeys(KINDS, given)
        unknown = [kind for kind in named if kind not in KINDS]
        if unknown:
            raise ParameterError(f"unknown kind {unknown[0]!r} in label.least_score (known: {', '.join(KINDS)})")
        scores = {**LEAST_SCORES, **named}
        for score in scores.values():
            if isinstance(score, bool) or not isinstance(score, int | float) or not 0 <= score <= 1:
                raise ParameterError(f"label.least_score must be a number from 0 to 1, or one per kind, got {given!r}")
        return scores

    @property
    def least_contrast(self) -> float | None:
        """Least contrast of a marking, standard deviations of the road; None where no markings are wanted."""
        value = self._of_markings("least_contrast", marking_lines.LEAST_CONTRAST)
        return None if self.markings is None else value

    @property
    def least_marking(self) -> float:
        """Length of the shortest marking, metres."""
        return self._of_markings("least_length", marking_lines.LEAST_LENGTH)

    def _of_markings(self, name: str, default: float) -> float:
        given = self._changes("markings", ("least_contrast", "least_length"))
        return check_positive(given.get(name, default), f"label.markings.{name}")

    def _changes(self, group: str, known: tuple[str, ...]) -> Mapping[str, Any]:
        given = getattr(self, group)
        if not isinstance(given, Mapping | None):
            raise ParameterError(f"label.{group} must have parameters below it, or be null, got {given!r}")
        unknown = [key for key in given or () if key not in known]
        if unknown:
            raise ParameterError(f"label.{group} has no parameter {unknown[0]!r} (parameters: {', '.join(known)})")
        return given or {}

    @property
    def survey_name(self) -> str:
        """The survey as text, for reports."""
        return self.survey if isinstance(self.survey, str) else ", ".join(map(str, self.survey))

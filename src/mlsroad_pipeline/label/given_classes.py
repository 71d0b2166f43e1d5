"""Classes that a survey comes with, in a scene: resolved by their class maps, as ground, and in the labels."""

from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.cameras.legend import Legend
from mlsroad_pipeline.algorithms.core.classes import IGNORE, ClassScheme, find_scheme
from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError, ReadError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.stage_parameters import GroundParameters
from mlsroad_pipeline.algorithms.core.stage_results import Ground
from mlsroad_pipeline.algorithms.ground.given_ground import MOST_ABOVE, beyond_ground, lifted_ground
from mlsroad_pipeline.algorithms.ground.surface import height_above_ground
from mlsroad_pipeline.algorithms.inventory.lines.kerbs.kerb_lines import ground_classes
from mlsroad_pipeline.algorithms.models.boosted_trees.corrected import labeller_of
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle, bundle_scheme
from mlsroad_pipeline.algorithms.models.given_labels import labeller as given_labels
from mlsroad_pipeline.algorithms.models.labelling import SoftLabels
from mlsroad_pipeline.algorithms.stages import find_ground, inlier_rows, inliers
from mlsroad_pipeline.formats.registry import get_format
from mlsroad_pipeline.surveys import given_classes as source
from mlsroad_pipeline.surveys.plan import SurveyPlan

GIVEN_SCHEME = "road_inventory"
"""Class scheme of given classes where no model labels."""

KEPT_LABEL, KEPT_GROUND, LIFTED = "kept_label", "kept_ground", "lifted"
"""Columns of a scene: class of a kept point, -1 for none, `NOT_KEPT`; whether it is ground; contradicting ground."""
NOT_KEPT = -2
UNLABELLED, NOISE, ANY_GROUND = "unlabelled", "outlier", "other_ground"
"""Classes of a class map with a meaning here: labelled by the method; left out; the method chooses among ground."""
MOST_BELOW = 1.0
"""Depth below the ground from which a kept class other than ground contradicts itself, metres."""

_CHECKED = 2_000_000  # rows of predictions that are read at once


@dataclass(frozen=True)
class GivenClasses:
    """Class maps of the classes that a survey comes with."""

    kept: Legend | None = None  # Of the kept classes
    predicted: Legend | None = None  # Of the predictions
    weight: float | str | None = None  # Of the predictions in a pool; None takes them alone
    # Class numbers that cannot be written back, because they mean another class in the output, to the two meanings
    clashes: Mapping[int, str] = field(default_factory=dict)

    def with_clashes(self, codes: NDArray[np.uint8], scheme: ClassScheme) -> Self:
        """Return the class maps for an output with these codes of the classes of a scheme."""
        if self.kept is None:
            return self
        is_ground, found = ground_classes(scheme), {}
        for number, name, label in zip(self.kept.numbers, self.kept.names, self.kept.labels(scheme), strict=True):
            written = np.flatnonzero(codes == number)
            same = label >= 0 and (np.isin(label, written) or (is_ground[label] and is_ground[written].any()))
            if len(written) and not same:
                other = scheme.classes[written[0]]
                found[number] = f"{name} in class map {self.kept.source} and {other} in the results"
        return replace(self, clashes=found)

    def code_names(self, names: Mapping[int, str]) -> dict[int, str]:
        """Return names of LAS codes with those of kept ones added."""
        if self.kept is None:
            return dict(names)
        own = dict(zip(self.kept.numbers, self.kept.names, strict=True))
        return {number: name for number, name in own.items() if number <= np.iinfo(np.uint8).max} | dict(names)


def given_classes(
    plan: SurveyPlan, bundle: ModelBundle, codes: NDArray[np.uint8], codings: Mapping[str, Any]
) -> GivenClasses | None:
    """Return the class maps of a survey for a model that writes `codes`; None where the survey has no given classes."""
    given, scheme = plan.given, bundle_scheme(bundle)
    if not given.in_use:
        return None
    if given.labels is not None and given.weight is None and labeller_of(bundle).slug != given_labels.SLUG:
        raise ParameterError(
            f"label.given.labels take the place of the model {bundle.slug}: set label.given.weight to pool them, or "
            "leave out label.method and label.model"
        )
    suffixes = {Path(name).suffix.lower() for name in plan.predictions.values()}
    predicted = given.predicted_legend(scheme, codings, suffixes)
    found = GivenClasses(given.kept_legend(scheme, codings), predicted, given.weight)
    if not any(get_format(file.source.path).name == "LAS" for file in plan.files):
        return found
    return found.with_clashes(codes, scheme)


def check_predictions(plan: SurveyPlan, classes: Mapping[str, Any]) -> None:
    """Read all predictions before the survey; raise an error that names the first wrong file and its value.

    `classes` are the configured schemes and codings.
    """
    if plan.given.labels is None:
        return
    scheme = find_scheme(classes["schemes"], GIVEN_SCHEME)
    legend = None
    with suppress(ParameterError):  # it may name classes of the scheme of a model, which is not known yet
        suffixes = {Path(name).suffix.lower() for name in plan.predictions.values()}
        legend = plan.given.predicted_legend(scheme, classes["codings"], suffixes)
    for file in plan.files:
        cloud, predictions = file.source.path, Path(plan.predictions[file.key])
        try:
            n_points = get_format(cloud).info(Path(cloud), plan.options).n_points
        except ReadError:
            continue  # the reading of the survey reports a damaged cloud
        for start in range(0, max(n_points, 1), _CHECKED):
            columns = source.read_predictions(predictions, start, min(start + _CHECKED, n_points), n_points, cloud)
            if legend is not None and source.PREDICTED in columns:
                legend.places(columns[source.PREDICTED], source=str(predictions))
            elif legend is not None:
                legend.of_scores(columns[source.PROBABILITIES][:1][None], scheme, source=str(predictions))


def with_given(scene: PointCloud, given: GivenClasses | None, scheme: ClassScheme) -> PointCloud:
    """Return a scene with its given classes as classes of a scheme; given noise becomes an outlier."""
    if given is None:
        return scene
    columns: dict[str, NDArray] = {}
    if given.predicted is not None:
        columns |= _predicted(scene, given.predicted, scheme)
    if given.kept is not None:
        _check_clashes(scene, given.clashes)
        columns |= _kept(scene, given.kept, scheme)
    return scene.with_columns(**columns)


def _predicted(scene: PointCloud, legend: Legend, scheme: ClassScheme) -> dict[str, NDArray]:
    if source.PROBABILITIES in scene:
        scores = scene[source.PROBABILITIES][None]
        return {given_labels.PROBABILITIES: legend.of_scores(scores, scheme, source=scene.source)[0]}
    label = legend.labels(scheme)[legend.places(scene[source.PREDICTED], source=f"predictions of {scene.source}")]
    stated = scene.get(source.CONFIDENCE)
    sure = np.full(len(scene), given_labels.NUMBER_CONFIDENCE, dtype=np.float32) if stated is None else stated
    return {given_labels.LABEL: label, given_labels.CONFIDENCE: np.where(label < 0, np.float32(0), sure)}


def _check_clashes(scene: PointCloud, clashes: Mapping[int, str]) -> None:
    found = [number for number in clashes if (scene[source.KEPT] == number).any()]
    if found:
        raise DataError(
            f"{scene.source}: class number {found[0]} is {clashes[found[0]]}: keep others (label.given.keep), or write "
            "other codes (label.scheme=asprs, or road_inventory for codes from 64)"
        )


def _kept(scene: PointCloud, legend: Legend, scheme: ClassScheme) -> dict[str, NDArray]:
    numbers = scene[source.KEPT]
    rows = np.flatnonzero(numbers >= 0)
    place = legend.places(numbers[rows], source=scene.source)
    names = np.array([name or "" for name in legend.classes])
    rows, place = rows[names[place] != UNLABELLED], place[names[place] != UNLABELLED]
    label = np.full(len(scene), NOT_KEPT, dtype=np.int16)
    label[rows] = legend.labels(scheme)[place]
    noise, ground = np.zeros(len(scene), dtype=np.bool_), np.zeros(len(scene), dtype=np.bool_)
    noise[rows] = names[place] == NOISE
    ground[rows] = (legend.labels(scheme)[place] >= 0) & np.append(ground_classes(scheme), False)[label[rows]]
    any_ground = np.zeros(len(scene), dtype=np.bool_)
    any_ground[rows] = names[place] == ANY_GROUND
    columns = {KEPT_LABEL: label, KEPT_GROUND: ground, LIFTED: lifted_ground(scene.xyz, ground), ANY_GROUND: any_ground}
    return columns | ({"outlier": noise | ~inliers(scene)} if noise.any() else {})


def ground_of_scene(scene: PointCloud, parameters: GroundParameters) -> Ground:
    """Return the ground of a scene: the kept one, and that of the filter more than 5 m from it in plan.

    Kept ground that contradicts itself is left out.
    """
    if KEPT_GROUND not in scene or not (scene[KEPT_GROUND] & ~scene[LIFTED]).any():
        return find_ground(scene, parameters)
    ground = scene[KEPT_GROUND] & ~scene[LIFTED] & inliers(scene)
    far = beyond_ground(scene.xyz, ground)
    if (far & (scene[KEPT_LABEL] == NOT_KEPT)).any():
        ground |= far & (scene[KEPT_LABEL] == NOT_KEPT) & find_ground(scene, parameters)["ground"]
    keep = inlier_rows(scene)
    height = np.full(len(scene), np.nan, dtype=np.float32)
    height[keep] = height_above_ground(scene.xyz[keep], ground[keep], cell_size=parameters.surface_cell)
    return {"ground": ground, "height": height}


def labels_with_given(
    soft: SoftLabels, scene: PointCloud, given: GivenClasses | None, scheme: ClassScheme
) -> SoftLabels:
    """Return the labels of a method pooled with predictions and overruled by kept classes."""
    if given is None:
        return soft
    if given.weight is not None:
        soft = given_labels.pool_with_given(soft, scene, float(given.weight))
    if given.kept is None:
        return soft
    label, is_ground = scene[KEPT_LABEL], np.append(ground_classes(scheme), False)  # the last is of no class
    chosen = scene[ANY_GROUND] & is_ground[soft.labels]
    label = np.where(chosen, soft.labels, label).astype(np.int16)
    return given_labels.with_kept_labels(soft, label != NOT_KEPT, np.maximum(label, IGNORE), len(scheme))


def kept_codes(scene: PointCloud) -> NDArray[np.uint8] | None:
    """Return the class number of each kept point, 0 for the others; None where no class is kept."""
    if KEPT_LABEL not in scene:
        return None
    kept = (scene[KEPT_LABEL] != NOT_KEPT) & (scene[source.KEPT] <= np.iinfo(np.uint8).max)
    return np.where(kept, scene[source.KEPT], 0).astype(np.uint8)


def contradictions(scene: PointCloud, height: NDArray[np.float32]) -> NDArray[np.int64] | None:
    """Return the kept points of the core, those of contradicting ground, and other classes below the ground."""
    if KEPT_LABEL not in scene:
        return None
    core, label = scene["core"], scene[KEPT_LABEL]
    sunk = (label >= 0) & ~scene[KEPT_GROUND] & (height < -MOST_BELOW)
    return np.array([(part & core).sum() for part in (label != NOT_KEPT, scene[LIFTED], sunk)], dtype=np.int64)


def given_counts(scenes: Iterable[Mapping[str, Any]]) -> NDArray[np.int64] | None:
    """Return the counts of `contradictions` of the whole survey; None where no class was to be kept."""
    counts = [scene["given"] for scene in scenes if "given" in scene]
    return np.sum(counts, axis=0) if counts else None


def check_any_kept(counts: NDArray[np.int64] | None, survey: str) -> None:
    """Raise DataError if no point of a survey without a model has a class; `counts` as of `given_counts`."""
    if counts is None or not counts[0]:
        raise DataError(f"{survey}: no point has a class (codes 0 and 1 are none): label it with mlsroad label")


def given_warnings(counts: NDArray[np.int64] | None) -> list[str]:
    """Return the warnings about kept classes; `counts` as of `given_counts`."""
    if counts is None:
        return []
    kept, lifted, sunk = (int(count) for count in counts)
    if not kept:
        return ["No point has a class to keep (label.given.keep_classes): all are labelled by the method."]
    warnings = []
    if lifted:
        warnings.append(
            f"{lifted:,} points of given ground lie more than {MOST_ABOVE:g} m above the ground around them: they keep "
            "their class, but heights are not measured from them."
        )
    if sunk:
        warnings.append(f"{sunk:,} points of other given classes lie more than {MOST_BELOW:g} m below the ground.")
    return warnings

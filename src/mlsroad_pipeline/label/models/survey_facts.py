"""Facts of a survey that the choice of the model depends on, and their comparison with the training data of models."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import pandas as pd
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.quality.scene_facts import scene_facts
from mlsroad_pipeline.algorithms.quality.tables import quality_table
from mlsroad_pipeline.algorithms.quality.training_facts import median_facts, unusual_facts
from mlsroad_pipeline.algorithms.scenes.binning import BinCounts
from mlsroad_pipeline.algorithms.scenes.joining import join_pieces
from mlsroad_pipeline.algorithms.scenes.parameters import IngestParameters, OutlierParameters
from mlsroad_pipeline.execution.collection import SceneCollection
from mlsroad_pipeline.formats.options import NEW_SURVEY, ReadOptions
from mlsroad_pipeline.surveys.files import Survey
from mlsroad_pipeline.surveys.inspection import InspectParameters
from mlsroad_pipeline.surveys.plan import SurveyPlan, estimated_drives, plan_survey, trajectory_beside
from mlsroad_pipeline.surveys.reading import CutRange, FileDescription, describe_file, find_corridor, read_and_cut
from mlsroad_pipeline.surveys.scene_plan import RangeOfRows, cut_ranges, plan_drive

N_SCENES = 3
"""Number of scenes of the sample."""

_FIGURES = ("median_density", "concentration")

SPARSE_BELOW, SCAN_BELOW, SCAN_CONCENTRATION = 9.0, 15.0, 0.5
"""Median density below which a survey is sparse, points per square metre, and the density and the concentration below
which it is a single scan of a rotating scanner; docs/models.md has the figures."""


@dataclass(frozen=True)
class SurveyFacts:
    """Facts of a survey that the choice among the shipped models depends on.

    Parameters
    ----------
    median_density : float
        Median of the points per square metre in occupied cells of 1 m; of several files the median over their points.
    concentration : float
        How closely the points of a file lie about one place, see `DensityFigures`; of several files likewise.
    of_scenes : mapping of str to float
        Medians of `scene_facts` over a sample of scenes; empty if there are too few points.
    """

    median_density: float
    concentration: float
    of_scenes: Mapping[str, float] = field(default_factory=dict)

    @property
    def sparse(self) -> bool:
        """Return whether the survey is sparse or a single scan of a rotating scanner."""
        is_scan = self.median_density < SCAN_BELOW and self.concentration < SCAN_CONCENTRATION
        return self.median_density < SPARSE_BELOW or is_scan


def facts_of_survey(survey: str | Sequence[str], *, parameters: InspectParameters | None = None) -> SurveyFacts:
    """Return the facts of a file, folder or glob; reads all points once and those of a sample twice."""
    quality, of_scenes = read_survey(replace(parameters or InspectParameters(), survey=survey))
    return facts_of_quality(quality, of_scenes)


def facts_of_quality(quality: pd.DataFrame, of_scenes: Mapping[str, float] | None = None) -> SurveyFacts:
    """Return the facts of a table with the quality of all files, and of a sample of scenes."""
    density, concentration = (
        _median_over_points(quality[name].astype(float), quality["n_points"]) for name in _FIGURES
    )
    return SurveyFacts(density, concentration, of_scenes or {})


def _median_over_points(figures: pd.Series, n_points: pd.Series) -> float:
    """Return the figure of the file that holds the middle point; NaN without figures."""
    known = figures[figures.notna() & (n_points > 0)].sort_values(kind="stable")
    if not len(known):
        return float("nan")
    below = n_points[known.index].cumsum().to_numpy()
    return float(known.iloc[int((below >= below[-1] / 2).argmax())])


def facts_of_pieces(plan: SurveyPlan, pieces: SceneCollection, ingest: IngestParameters) -> dict[str, float]:
    """Return the facts of a survey that has been read and cut."""
    points = pieces.part("points", mapped=True)
    return _sampled_facts(plan, pieces.load_all("bins"), lambda key: points[key].load(), ingest)


def _sampled_facts(
    plan: SurveyPlan,
    bins: Mapping[str, BinCounts],
    load: Callable[[str], Mapping[str, NDArray]],
    ingest: IngestParameters,
) -> dict[str, float]:
    """Return the medians of the facts of scenes at equal steps."""
    scenes = [scene for drive in plan.drives() for scene in plan_drive(drive, plan, bins, ingest)]
    n = min(N_SCENES, len(scenes))
    chosen = [scenes[(2 * k + 1) * len(scenes) // (2 * n)] for k in range(n)]
    unfiltered = OutlierParameters(enabled=False)
    return median_facts(
        [
            scene_facts(join_pieces([_needed(load(key)) for key in scene.pieces], scene.span, unfiltered, scene.source))
            for scene in chosen
        ]
    )


def _needed(piece: Mapping[str, NDArray]) -> dict[str, NDArray]:
    """Return a stored piece without the columns that no fact depends on."""
    kept = {f"column.{name}" for name in ("file", "row", "intensity")}
    return {name: piece[name] for name in piece if name in kept or not name.startswith("column.")}


def read_survey(
    parameters: InspectParameters, ingest: IngestParameters | None = None
) -> tuple[pd.DataFrame, dict[str, float]]:
    """Return the quality of the files of a survey and its facts; points of the sample are read twice."""
    cutting = ingest or IngestParameters()
    options = ReadOptions.from_config({**NEW_SURVEY, **parameters.read})
    text = options.delimiter is None and options.decimal is None  # as in `plan.plan_labelling`
    listing = Survey.at(parameters.survey).listing(trajectory=parameters.trajectory, text=text)
    plan = plan_survey({"survey": listing.files}, {}, options=options, labels=False, ingest=cutting)
    described = _describe(plan, cutting)
    plan = replace(plan, files=tuple(file for file in plan.files if file.key in described))
    cut = _cutter(plan, described, cutting)
    bins, quality = {}, {}
    ranges = {item.key: item for item in cut_ranges(plan, {k: d["info"] for k, d in described.items()}, cutting)}
    for key, item in ranges.items():
        parts = cut(item)
        bins[key], quality[key] = parts["bins"], parts["quality"]
    table = quality_table({file.source.name: file.key for file in plan.files}, quality)
    return table, _sampled_facts(plan, bins, lambda key: cut(ranges[key])["points"], cutting)


def _describe(plan: SurveyPlan, ingest: IngestParameters) -> dict[str, FileDescription]:
    """Describe the files that can be read."""
    estimated, described, reason = estimated_drives(plan, ingest), {}, ""
    for file in plan.files:
        try:
            described[file.key] = describe_file(
                file.source.path, options=plan.options, labels=False, windows=file.drive in estimated
            )
        except DataError as error:
            reason = reason or f"{file.source.name} cannot be read: {error}"
    if not described:
        raise ParameterError(f"no file of the survey can be read: {reason}")
    return described


def _cutter(
    plan: SurveyPlan, described: Mapping[str, FileDescription], ingest: IngestParameters
) -> Callable[[RangeOfRows], CutRange]:
    """Return the function that reads a range of rows and sorts it into bins."""
    corridors = {
        drive: find_corridor(
            [described[file.key]["sample"] for file in files],
            [described[file.key]["windows"] for file in files],
            trajectory=trajectory_beside(files),
            along=ingest.cut == "along",
            factors=described[files[0].key]["info"]["factors"],
        )
        for drive, files in plan.drives().items()
    }

    def cut(item: RangeOfRows) -> CutRange:
        return read_and_cut(item.file.source.path, corridors[item.file.drive], **item.parameters(plan, ingest))

    return cut


def unusual_properties(bundle: ModelBundle, facts: Mapping[str, float]) -> list[str]:
    """Return one sentence per property of a survey that is outside the range of the training data of a model."""
    try:
        return unusual_facts(facts, bundle.metadata.get("training_facts", {}))
    except DataError as error:
        raise DataError(f"the model of {bundle.slug} is damaged: {error}") from error


def unusual_warnings(properties: Sequence[str]) -> list[str]:
    """Return a warning for each unusual property."""
    return [f"The survey differs from the training data: {sentence}." for sentence in properties]

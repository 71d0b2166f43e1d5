"""Pipeline that scores an inventory against a table of true objects."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from kedro.pipeline import Node, Pipeline

from mlsroad_pipeline.algorithms.core.palette import las_palette
from mlsroad_pipeline.label.object_scoring import (
    Case,
    ScoredInventory,
    ScoreParameters,
    score_inventory,
    score_record,
    worst_cases,
)
from mlsroad_pipeline.reporting.clouds.object_pictures import object_picture
from mlsroad_pipeline.reporting.html.gallery import Picture
from mlsroad_pipeline.reporting.score_page import score_page
from mlsroad_pipeline.surveys.cut_outs import CutOut, cut_out


def score_objects_of_inventory(parameters: ScoreParameters) -> tuple[dict[str, Any], *tuple[pd.DataFrame, ...], str]:
    """Return the scores as JSON and as tables (by kind, by threshold, of measures, outcomes), and their page."""
    scored = score_inventory(parameters)
    tables = (scored.scores, scored.curve, scored.measures, scored.matched.objects, scored.matched.truth)
    facts = {"inventory": parameters.inventory, "truth": parameters.truth, "kind of truth": scored.source}
    page = score_page(facts, scored.scores, scored.curve, scored.measures, worst_pictures(scored))
    return score_record(scored, parameters), *tables, page


def worst_pictures(scored: ScoredInventory) -> dict[str, list[Picture]]:
    """Return pictures of the worst objects by kind and outcome; none without labelled clouds."""
    groups = worst_cases(scored) if scored.clouds else {}
    pictures = iter(pictures_of([case for group in groups.values() for case in group], scored.clouds))
    return {name: [next(pictures) for _ in group] for name, group in groups.items()}


def pictures_of(cases: Sequence[Case], clouds: Sequence[Path]) -> list[Picture]:
    """Return a picture of each object, cut out of the labelled clouds."""
    reach = np.array([min(max(0.9 * case.size, 2.5), 9.0) for case in cases])
    places = np.array([(case.x, case.y) for case in cases]).reshape(-1, 2)
    parts = cut_out(clouds, places, reach)
    return [_picture(case, part, half) for case, part, half in zip(cases, parts, reach, strict=True)]


def _picture(case: Case, part: CutOut, reach: float) -> Picture:
    lowest = float(np.quantile(part.xyz[:, 2], 0.02)) if len(part.xyz) else 0.0
    true = None if case.true is None else (case.true[0] - case.x, case.true[1] - case.y)
    bottom = lowest if np.isnan(case.z) else case.z
    colours = las_palette()[part.code]
    return Picture(
        object_picture(part.xyz, colours, reach=reach, bottom=bottom, listed=case.listed, true=true), case.text
    )


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline from an inventory and a table of true objects to scores and pictures of the worst objects."""
    return Pipeline(
        [
            Node(
                score_objects_of_inventory,
                "params:score",
                [
                    "object_scores_record",
                    "object_scores",
                    "object_curve",
                    "object_measures",
                    "object_outcomes",
                    "true_object_outcomes",
                    "object_scores_page",
                ],
                name="score_objects_of_inventory",
            )
        ]
    )

"""What the study of Tomic et al. 2019 runs, street by street, and the worker that fuses what both methods say."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.detrended_forest.labeller import StageParameters
from mlsroad_pipeline.algorithms.detrended_forest.training import ForestParameters
from mlsroad_pipeline.algorithms.fusion.log_linear_pool import PoolParameters
from mlsroad_pipeline.algorithms.image_labels.training_parameters import ImageLabelsParameters
from mlsroad_pipeline.algorithms.stages import FeatureParameters, GroundParameters, SupervoxelParameters
from mlsroad_pipeline.studies.parameters import changed
from mlsroad_pipeline.studies.tomic2019.parameters import (
    PAPER_COLUMNS,
    PAPER_FEATURES,
    Division,
    ForestVariant,
    StudyParameters,
)
from mlsroad_pipeline.studies.tomic2019.scores import TestSet, fuse_test_sets

PRINTED, OWN = "printed_forest", "detrended_forest"
"""Method 1 with the features of section 2.1, and with those of this project."""

Arrays = Mapping[str, NDArray]


@dataclass(frozen=True)
class StudyPlan:
    """What the study runs.

    Parameters
    ----------
    study : StudyParameters
        Scale, surveys and seeds.
    scheme : ClassScheme
        The classes.
    ground : GroundParameters
        The ground filter.
    division : Division
        Where surveys are cut.
    forests : mapping of str to ForestVariant
        `PRINTED` and `OWN` to method 1.
    images : ImageLabelsParameters
        Method 2.
    pool : PoolParameters
        The probabilistic fusion.
    """

    study: StudyParameters
    scheme: ClassScheme
    ground: GroundParameters
    division: Division
    forests: Mapping[str, ForestVariant]
    images: ImageLabelsParameters
    pool: PoolParameters

    @property
    def streets(self) -> list[str]:
        """Names of the surveys."""
        return [street_key(seed) for seed in self.study.chosen_scale().seeds]

    def training_street(self, street: str) -> str:
        """Return the survey whose first half trains the feature-based method that labels a survey."""
        if self.study.chosen_scale().train_on == "same":
            return street
        return self.streets[(self.streets.index(street) + 1) % len(self.streets)]


def street_key(seed: int) -> str:
    """Return the name of a street."""
    return f"seed_{seed}"


def make_plan(
    study: StudyParameters,
    scheme: ClassScheme,
    ground: GroundParameters,
    supervoxels: SupervoxelParameters,
    features: FeatureParameters,
    forest: ForestParameters,
    images: ImageLabelsParameters,
    pool: PoolParameters,
    *,
    length: float,
) -> StudyPlan:
    """Put the study together, with what its scale changes."""
    scale = study.chosen_scale()
    own = changed(forest, scale.methods.get("detrended_forest", {}))
    stages = StageParameters(ground, supervoxels, features)
    printed = replace(stages, features=changed(features, study.printed_features))
    forests = {
        PRINTED: ForestVariant(changed(own, study.printed_forest), printed, PAPER_COLUMNS, PAPER_FEATURES),
        OWN: ForestVariant(own, stages, (*PAPER_COLUMNS, "rgb")),
    }
    return StudyPlan(
        study, scheme, ground, Division(length, scale.gap), forests,
        changed(images, scale.methods.get("image_labels", {})), changed(pool, scale.methods.get("fusion", {})),
    )  # fmt: skip


def fuse_survey(
    points: PointCloud,
    features: Arrays,
    images: Arrays,
    *,
    division: Division,
    scheme: ClassScheme,
    pool: PoolParameters,
) -> dict[str, Any]:
    """Fuse what both methods say of a survey."""
    half = division.rows(points["station"], "test")
    truth = scheme.encode(points["label"], source=points.source)

    def part(name: Any) -> TestSet:
        rows = division.rows(points["station"], name)
        at = np.searchsorted(half, rows)
        given = (features["probabilities"][at], images["probabilities"][:, at])
        return TestSet(truth[rows], *(table.astype(np.float32) for table in given))

    found = fuse_test_sets(part("test1"), part("test2"), pool=pool)
    results = {
        **found.confusions,
        "camera_f1": found.camera_f1,
        "method_f1": found.method_f1,
        "redundancy": found.redundancy,
        "penalty": np.array(found.penalty),
        "cameras": images["cameras"],
    }
    return {"answers": found.answers, "results": results}

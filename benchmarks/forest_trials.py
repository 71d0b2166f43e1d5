"""Shared parts of trials of the detrended forest: the configuration, the stages before the forest, a row of figures."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.stage_parameters import (
    FeatureParameters,
    GroundParameters,
    StageParameters,
    SupervoxelParameters,
)
from mlsroad_pipeline.algorithms.metrics.confusion import scores
from mlsroad_pipeline.algorithms.stages import build_supervoxels, describe_supervoxels, find_ground

CONF = Path(__file__).resolve().parents[1] / "conf"


def configured(group: str, environment: str | None = None) -> dict[str, Any]:
    """Return a group of parameters as an environment has it; None is the base."""
    base = yaml.safe_load((CONF / f"base/parameters_{group}.yml").read_text(encoding="utf-8"))[group]
    if environment is None:
        return dict(base)
    own = yaml.safe_load((CONF / environment / "parameters.yml").read_text(encoding="utf-8")).get(group, {})
    return {**base, **own}


def configured_stages(environment: str | None = None, *, detrend: bool = True) -> StageParameters:
    """Return how scenes are prepared; False leaves detrending out."""
    features = FeatureParameters(**configured("features", environment))
    return StageParameters(
        GroundParameters(**configured("ground_removal", environment)),
        SupervoxelParameters(**configured("supervoxelise", environment)),
        replace(features, detrend=features.detrend and detrend),
    )


def configured_scheme(name: str, environment: str | None = None) -> ClassScheme:
    """Return a class scheme by its name."""
    return ClassScheme.from_config(name, configured("classes", environment)["schemes"][name])


def prepare(scene: PointCloud, stages: StageParameters) -> dict[str, Any]:
    """Run the stages before the forest."""
    ground = find_ground(scene, stages.ground)
    supervoxels = build_supervoxels(scene, stages.supervoxels)
    features = describe_supervoxels(scene, ground, supervoxels, stages.features)
    return {"scene": scene, "supervoxels": supervoxels, "features": features}


def report(name: str, seed: int, matrix: np.ndarray, scheme: ClassScheme) -> None:
    """Print a row of the table, and the same as JSON."""
    found = scores(matrix)
    f1 = {label: round(float(value), 4) for label, value in zip(scheme.classes, found.f1, strict=True)}
    print(f"{name:10s} seed {seed:<5d} OA {found.overall_accuracy:.4f}  mean F1 {found.mean_f1:.4f}  {f1}")
    row = {"of": name, "seed": seed, "overall_accuracy": found.overall_accuracy, "mean_f1": found.mean_f1, "f1": f1}
    print(json.dumps(row), flush=True)

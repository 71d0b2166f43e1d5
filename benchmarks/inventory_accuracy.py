"""Errors of the measurements of the inventory on simulated streets.

    python benchmarks/inventory_accuracy.py [--preset demo] [--kinds town ring_road suburb] [--seeds 3 4]

Two figures for every measurement: of objects whose points are known (the error of measuring alone), and of the
inventory of the whole street, made by `extract_objects` from points with their true classes. Heights are above the
ground that the ground filter finds. Moving objects and those with too few points for an inventory are left out.
"""

from __future__ import annotations

import json
import os
import time
from dataclasses import replace
from itertools import product

import numpy as np
import pandas as pd
from _common import markdown, parser

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY, TAXONOMY_NAMES
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.stage_parameters import GroundParameters
from mlsroad_pipeline.algorithms.inventory.objects.extraction import extract_objects, measure_points
from mlsroad_pipeline.algorithms.inventory.objects.merging import merge_across_scenes
from mlsroad_pipeline.algorithms.inventory.objects.rules import KIND_OF_CLASS, ObjectRule
from mlsroad_pipeline.algorithms.inventory.scoring.measure_errors import (
    kinds_of_truth,
    match_to_truth,
    measurement_errors,
    summarise_errors,
)
from mlsroad_pipeline.algorithms.stages import find_ground
from mlsroad_pipeline.simulation import PRESETS, simulate_survey
from mlsroad_pipeline.simulation.parameters.street_parameters import STREETS

# Stem and crown of a tree are one class, all else is found class by class.
MEMBERS = {name: ("trunk", "tree") if name == "tree" else (name,) for name in KIND_OF_CLASS if name != "trunk"}
RULES = {
    name: ObjectRule.of_kind(KIND_OF_CLASS[name], tuple(TAXONOMY[member] for member in members))
    for name, members in MEMBERS.items()
}


def errors_of_known(
    cloud: PointCloud, origin: np.ndarray, height: np.ndarray, truth: pd.DataFrame
) -> tuple[pd.DataFrame, float]:
    """Measure every true object from its own points; return the errors and the time that measuring took."""
    label = cloud["label"]
    mine = np.flatnonzero(np.isin(cloud["instance"], truth["instance"]) & np.isfinite(height))
    mine = mine[np.argsort(cloud["instance"][mine], kind="stable")]
    first, last = (np.searchsorted(cloud["instance"][mine], truth["instance"], side=s) for s in ("left", "right"))
    rows, kept, spent = [], [], 0.0
    for row, (a, b, code) in enumerate(zip(first, last, truth["label"], strict=True)):
        rule = RULES[TAXONOMY_NAMES[code]]
        points = mine[a:b][np.isin(label[mine[a:b]], rule.labels)]
        if len(points) < rule.min_points:
            continue
        start = time.process_time()
        found = measure_points(cloud.xyz[points], rule, height_above_ground=height[points], origin=origin)
        spent += time.process_time() - start
        rows.append({**found, "kind": rule.kind})
        kept.append(row)
    return measurement_errors(pd.DataFrame(rows), truth.iloc[kept]), spent


def errors_of_found(
    cloud: PointCloud, origin: np.ndarray, height: np.ndarray, truth: pd.DataFrame
) -> tuple[pd.DataFrame, int, int]:
    """Make the inventory from true classes; return the errors of what it has, its size and that of the truth."""
    known = np.isfinite(height)
    piece = extract_objects(
        cloud.xyz[known],
        cloud["label"][known],
        np.ones(known.sum()),
        classes=RULES,
        origin=origin,
        height_above_ground=height[known],
    )
    objects = merge_across_scenes([piece], classes=RULES)
    found, true = match_to_truth(objects, truth)
    return measurement_errors(objects.iloc[found], truth.iloc[true]), len(objects), len(truth)


def main() -> None:
    """Simulate, measure, compare, print."""
    arguments = parser(__doc__)
    arguments.add_argument("--preset", default="demo", choices=list(PRESETS))
    arguments.add_argument("--kinds", nargs="+", default=["town", "ring_road", "suburb"], choices=list(STREETS))
    arguments.add_argument("--seeds", type=int, nargs="+", default=[3, 4])
    options = arguments.parse_args()
    parts: dict[str, list[pd.DataFrame]] = {"own points": [], "inventory": []}
    measured, spent, n_found, n_true = 0, 0.0, 0, 0
    for kind, seed in product(options.kinds, options.seeds):
        parameters = replace(PRESETS[options.preset], seed=seed, street=STREETS[kind], with_images=False)
        survey = simulate_survey(parameters, n_threads=os.cpu_count() or 1)
        height = find_ground(survey.cloud, GroundParameters())["height"]
        truth = kinds_of_truth(survey.objects, KIND_OF_CLASS)
        own, seconds = errors_of_known(survey.cloud, survey.origin, height, truth)
        found, there, expected = errors_of_found(survey.cloud, survey.origin, height, truth)
        parts["own points"].append(own)
        parts["inventory"].append(found)
        measured, spent, n_found, n_true = measured + len(own), spent + seconds, n_found + there, n_true + expected
    tables = [summarise_errors(pd.concat(errors)).assign(of=name) for name, errors in parts.items()]
    table = pd.concat(tables)[["of", "class", "measure", "unit", "n", "bias", "median", "quantile_90"]]
    print(markdown(table.round(3)))
    row = {"measured": measured, "milliseconds_per_object": 1e3 * spent / measured, "in_inventory": n_found}
    print(json.dumps(row | {"true_objects": n_true, "matched": sum(map(len, parts["inventory"]))}))


if __name__ == "__main__":
    main()

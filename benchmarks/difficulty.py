"""Difficulty of simulated streets: scores of a forest that uses the neighbourhood of a point and no context.

    python benchmarks/difficulty.py [--preset small] [--train 7 1 2] [--test 11 12 13] [--radius 0.5] [--kind town]

A random forest on the eigenvalue features of one radius, the height above ground and the intensity of each point learns
the classes of luo2016 on some streets and labels others. A simulated street on which it does well would be too easy to
compare methods on: its mean F1 over the seven classes should stay below 0.80. Prints a table and a JSON line.
"""

from __future__ import annotations

import argparse
import json
import os
from dataclasses import replace

import numpy as np
import yaml
from sklearn.ensemble import RandomForestClassifier
from transfer import CONF

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.core.stage_parameters import GroundParameters
from mlsroad_pipeline.algorithms.features.eigen import EIGEN_FEATURES, compute_eigen_features
from mlsroad_pipeline.algorithms.metrics.confusion import confusion_matrix, scores
from mlsroad_pipeline.algorithms.stages import find_ground
from mlsroad_pipeline.simulation import PRESETS, simulate_survey
from mlsroad_pipeline.simulation.parameters.street_parameters import STREETS

SCHEME = "luo2016"
FEATURES = [name for name in EIGEN_FEATURES if name not in ("nx", "ny", "nz", "direction_x", "direction_y")]
PER_CLASS = 6000  # points of a class and street to learn from
EVERY = 5  # one in so many points is tested


def points_of(preset: str, kind: str, seed: int, radius: float, scheme: ClassScheme) -> tuple[np.ndarray, np.ndarray]:
    """Simulate a street and return its points' features and labels."""
    parameters = replace(PRESETS[preset], seed=seed, street=STREETS[kind], with_images=False)
    cloud = simulate_survey(parameters, n_threads=os.cpu_count() or 1).cloud
    shape = compute_eigen_features(cloud.xyz, radius=radius)
    height = find_ground(cloud, GroundParameters())["height"]
    columns = [*(shape[name] for name in FEATURES), height, cloud["intensity"]]
    labels = scheme.encode(cloud["label"], source=f"street {seed}")
    known = labels >= 0
    return np.column_stack(columns)[known].astype(np.float32), labels[known]


def main() -> None:
    """Train, test and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--preset", default="small", choices=list(PRESETS))
    parser.add_argument("--kind", default="town", choices=list(STREETS))
    parser.add_argument("--train", type=int, nargs="+", default=[7, 1, 2])
    parser.add_argument("--test", type=int, nargs="+", default=[11, 12, 13])
    parser.add_argument("--radius", type=float, default=0.5)
    parser.add_argument("--trees", type=int, default=60)
    options = parser.parse_args()
    schemes = yaml.safe_load((CONF / "base/parameters_classes.yml").read_text(encoding="utf-8"))["classes"]["schemes"]
    scheme = ClassScheme.from_config(SCHEME, schemes[SCHEME])
    rng, features, labels = np.random.default_rng(0), [], []
    for seed in options.train:
        values, truth = points_of(options.preset, options.kind, seed, options.radius, scheme)
        rows = [rng.permutation(np.flatnonzero(truth == c))[:PER_CLASS] for c in range(len(scheme))]
        chosen = np.concatenate(rows)
        features.append(values[chosen])
        labels.append(truth[chosen])
    forest = RandomForestClassifier(options.trees, min_samples_leaf=2, n_jobs=os.cpu_count() or 1, random_state=0)
    forest.fit(np.concatenate(features), np.concatenate(labels))
    total = np.zeros((len(scheme), len(scheme) + 1), np.int64)
    for seed in options.test:
        values, truth = points_of(options.preset, options.kind, seed, options.radius, scheme)
        total += confusion_matrix(truth[::EVERY], forest.predict(values[::EVERY]), len(scheme))
    found = scores(total)
    seven = [i for i, name in enumerate(scheme.classes) if name != "other" and total[i].sum()]
    mean = float(np.nanmean(found.f1[seven]))
    for i, name in enumerate(scheme.classes):
        print(f"{name:12s} F1 {found.f1[i]:.3f}  points {total[i].sum()}")
    row = {
        "stage": "difficulty", "preset": options.preset, "kind": options.kind, "radius": options.radius,
        "mean_f1_of_seven": mean, "mean_f1_with_other": float(found.mean_f1),
        "overall_accuracy": float(found.overall_accuracy),
    }  # fmt: skip
    print(json.dumps(row))


if __name__ == "__main__":
    main()

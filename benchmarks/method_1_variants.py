"""Variants of method 1 of Tomic et al. 2019 on test set 2 of the study's surveys, without images.

    kedro run --pipelines=tomic2019_study --to-nodes=label_tomic2019_by_features
    python benchmarks/method_1_variants.py

Prints overall accuracy, kappa and mean F1 of every variant: mean and standard deviation over the surveys.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import pandas as pd
from kedro.framework.session import KedroSession
from kedro.framework.startup import bootstrap_project

from mlsroad_pipeline.algorithms.core.classes import find_scheme
from mlsroad_pipeline.algorithms.metrics.confusion import confusion_matrix, scores
from mlsroad_pipeline.papers.tomic2019.study.parameters import Division
from mlsroad_pipeline.simulation.parameters.presets import simulation_parameters


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--root", type=Path, default=Path.cwd())
    root = parser.parse_args().root.resolve()
    bootstrap_project(root)
    with KedroSession.create(root) as session:
        context = session.load_context()
        scale = context.params["tomic2019_study"].chosen_scale()
        scheme = find_scheme(context.params["classes"]["schemes"], "tomic2019")
        streets = context.catalog.load("tomic2019_study.streets").part("points")
        labels = context.catalog.load("tomic2019_study.by_features").part("labels")
    division = Division(simulation_parameters(scale.survey).length, scale.gap)
    rows = []
    for key in labels:
        variant, _, street = key.partition(".")
        cloud = streets[street].load()
        part, half = (division.rows(cloud["station"], name) for name in ("test2", "test"))
        predicted = labels[key].load()["probabilities"][np.searchsorted(half, part)].argmax(axis=1)
        truth = scheme.encode(cloud["label"])[part]
        found = scores(confusion_matrix(truth, predicted, len(scheme)))
        figures = {"overall_accuracy": found.overall_accuracy, "kappa": found.kappa, "mean_f1": found.mean_f1}
        rows.append({"variant": variant, "street": street, **figures})
    table = pd.DataFrame(rows)
    print(table.round(3).to_string(index=False))
    columns = ["overall_accuracy", "kappa", "mean_f1"]
    print(table.groupby("variant", sort=False)[columns].agg(["mean", "std"]).round(3).to_string())


if __name__ == "__main__":
    main()

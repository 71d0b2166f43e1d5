"""Measure the effect of intensity on the cuts: weighted coverage per street with and without intensity.

    kedro run --pipelines=yu2016_study --to-nodes=segment_yu2016_streets
    python benchmarks/cut_intensity.py [--jobs 2]

Reads the training streets of the study of Yu et al. 2016 and their stored segmentation with intensity, and segments
them without intensity. The twelve test streets of the study are too few to detect differences of 0.01. The training
streets have more signs and traffic, and were used to choose parameters: `sigma_i` and `max_cut` on the first twelve
streets of each survey, `tall_smoothing` on most of them.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import joblib
import numpy as np
import pandas as pd
from kedro.framework.session import KedroSession
from kedro.framework.startup import bootstrap_project

from mlsroad_pipeline.execution.collection import SceneCollection
from mlsroad_pipeline.papers.shared.studies.tables import paired_interval
from mlsroad_pipeline.papers.yu2016.study.keys import street_key
from mlsroad_pipeline.papers.yu2016.study.objects import segment_street
from mlsroad_pipeline.papers.yu2016.study.parameters import CUT
from mlsroad_pipeline.papers.yu2016.study.plan import StudyPlan, plan_study
from mlsroad_pipeline.pipelines.yu2016_study.pipeline import create_pipeline

FIGURES = ("weighted_coverage", "coverage", "weighted_touching", "touching", "wanted")


def stored(*names: str, scale: str = "study") -> tuple[StudyPlan, *tuple[SceneCollection, ...]]:
    """Return the plan of the study at a scale and its stored results of these names."""
    root = Path(__file__).parents[1]
    bootstrap_project(root)
    with KedroSession.create(root, runtime_params={"yu2016_study": {"scale": scale}}) as session:
        catalog = session.load_context().catalog
        [planned] = [node for node in create_pipeline().nodes if node.name == "plan_yu2016_study"]
        plan = plan_study(*(catalog.load(name) for name in planned.inputs))
        return plan, *(catalog.load(f"yu2016_study.{name}") for name in names)


def compare(key: str, plan: StudyPlan, streets: SceneCollection, objects: SceneCollection) -> dict[str, float]:
    """Return the differences of a street's scores between the cut with intensity and that without."""
    blind = replace(plan.stages.segmentation, method="normalized_cut_geometry")
    given = {"parameters": blind, "scheme": plan.scheme, "detection": plan.detection}
    without = segment_street(streets.part("points")[key].load(), **given)["scores"]
    found = objects.part("scores")[f"{CUT}.{key}"].load()
    return {name: float(found[name]) for name in FIGURES} | {
        f"{name}_gain": float(found[name]) - float(without[name]) for name in FIGURES
    }


def main() -> None:
    """Run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--jobs", type=int, default=2)
    args = parser.parse_args()
    plan, streets, objects = stored("streets", "objects")
    rows = []
    for survey, given in plan.scale.surveys.items():
        keys = [street_key(survey, seed) for seed in given.train]
        jobs = (joblib.delayed(compare)(key, plan, streets, objects) for key in keys)
        table = pd.DataFrame(joblib.Parallel(n_jobs=args.jobs)(jobs))
        for name in FIGURES:
            gain, low, high, n = paired_interval(table[f"{name}_gain"].to_numpy())
            ahead = int((table[f"{name}_gain"] > 0).sum()), int((table[f"{name}_gain"] < 0).sum())
            rows.append((survey, name, n, np.nanmean(table[name]), gain, low, high, *ahead))
    columns = ["survey", "figure", "streets", "with", "gain", "low", "high", "better", "worse"]
    print(pd.DataFrame(rows, columns=columns).round(4).to_string(index=False))


if __name__ == "__main__":
    main()

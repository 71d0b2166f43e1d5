"""Scores of the shipped models on recordings for their cards, and the labels that tests compare with.

    python benchmarks/shipped_models.py --record data/08_reporting/recordings/recordings_study/benchmark.json
    python benchmarks/shipped_models.py --predictions FOLDER

`--record` replaces the scores of the recordings in the registry of the package and in the cards by those of
`kedro run --env=recordings --params=recordings_study.protocol=shipped`. `--predictions` writes a part of a simulated
street with the labels of each model for the tests (FOLDER is tests/model_store/predictions).
"""

from __future__ import annotations

import argparse
import json
import logging
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.models.bundle import bundle_scheme
from mlsroad_pipeline.algorithms.models.labelling import label_cloud
from mlsroad_pipeline.model_store.shipped_models import (
    ModelScores,
    ShippedModel,
    load_shipped,
    save_entry,
    shipped_models,
)
from mlsroad_pipeline.simulation import simulate_survey
from mlsroad_pipeline.simulation.parameters.presets import simulation_parameters

COMMAND = "kedro run --env=recordings"

PREDICTED: dict[str, dict[str, Any]] = {
    "general": {"preset": "tiny", "seed": 12},
    "pool": {"preset": "tiny", "seed": 13},
}
"""Street whose first `COMPARED` points the tests compare."""
COMPARED = 9000


def recorded_scores(path: Path, model: ShippedModel) -> list[ModelScores]:
    """Return the scores of a model over all points of each recording, from the summary of the benchmark."""
    told = json.loads(path.read_text(encoding="utf-8"))
    rows = []
    for run in told["runs"]:
        if (run["protocol"], run["method"], run["part"]) == ("shipped", model.name, "all"):
            source = told["sources"][run["source"]]
            f1 = {name: round(run[f"f1_{name}"], 4) if f"f1_{name}" in run else None for name in source["classes"]}
            accuracy, mean = round(run["overall_accuracy"], 4), round(run["mean_f1"], 4)
            title = f"{source['title']}, trained on" if run["source"] in model.recordings else source["title"]
            rows.append(ModelScores(title, run["points"], accuracy, mean, f1, COMMAND))
    return rows


def write_predictions(folder: Path) -> None:
    """Write points of simulated streets, in millimetres, and the labels that each model gives them."""
    for name, street in PREDICTED.items():
        cloud = simulate_survey(simulation_parameters(street)).cloud
        cloud = cloud.select(np.arange(COMPARED))
        stored = {
            "xyz": np.rint(cloud.xyz * 1000).astype(np.int32),
            "rgb": cloud["rgb"],
            "intensity": np.rint(cloud["intensity"] * 255).astype(np.uint8),
            "truth": bundle_scheme(load_shipped(name)).encode(cloud["label"]),
        }
        for attributes in ((), ("intensity",), ("rgb", "intensity")):
            label, _ = label_cloud(load_shipped(name), predicted_cloud(stored, attributes))
            stored["+".join(("geometry", *attributes))] = label.astype(np.int8)
        np.savez_compressed(folder / f"{name}.npz", **stored)
        print(f"{folder / name}.npz: {len(cloud)} points")


def predicted_cloud(stored: Mapping[str, NDArray], attributes: Sequence[str]) -> PointCloud:
    """Return stored points with some of their attributes."""
    columns = {"rgb": stored["rgb"], "intensity": stored["intensity"].astype(np.float32) / 255}
    return PointCloud(stored["xyz"] / 1000, {name: columns[name] for name in attributes}, source="stored points")


def main() -> None:
    """Do what the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--record", type=Path, metavar="FILE")
    parser.add_argument("--predictions", type=Path, metavar="FOLDER")
    options = parser.parse_args()
    logging.disable(logging.WARNING)  # one warning per frame that has no colour
    if options.predictions:
        write_predictions(options.predictions)
    for name, entry in shipped_models().items() if options.record else ():
        rows = recorded_scores(options.record, entry)
        if not rows:
            print(f"{name}: the benchmark has no scores, the entry keeps its own")
            continue
        kept = [row for row in entry.scores if row.command not in (COMMAND, "python benchmarks/shipped_models.py")]
        save_entry(replace(entry, scores=(*kept, *rows)))
        print(f"{name}: {len(rows)} recordings")


if __name__ == "__main__":
    main()

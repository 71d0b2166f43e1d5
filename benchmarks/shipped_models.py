"""Scores of the shipped models on public recordings, and the facts that the choice between them depends on.

    python benchmarks/shipped_models.py [--models dense sparse] [--data oakland kitti pandaset ika] [--record]
    python benchmarks/shipped_models.py --facts FILE...
    python benchmarks/shipped_models.py --predictions FOLDER

Labels recordings below $MLSROAD_DATA with each model and compares with their labels in common classes: ground,
building, vegetation, pole, sign, vehicle, person, wire, other. Points without one are not scored. Each file or frame is
labelled alone. `--record` replaces the scores of the recordings in the registry of the package and in the cards.
`--facts` prints the median density of files, and the model that `label` takes. `--predictions` writes a part of a
simulated street with the labels of each model for the tests (FOLDER is tests/datasets/models/predictions).
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import logging
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from forest_trials import configured
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import Coding
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.metrics.confusion import confusion_matrix, scores
from mlsroad_pipeline.algorithms.models.bundle import bundle_scheme, label_cloud
from mlsroad_pipeline.algorithms.quality.chunks import inspect_chunk, merge
from mlsroad_pipeline.datasets.models.shipped_models import ModelScores, load_shipped, save_entry, shipped_models
from mlsroad_pipeline.formats.options import ReadOptions
from mlsroad_pipeline.formats.registry import get_format
from mlsroad_pipeline.label.model_choice import explain_choice
from mlsroad_pipeline.simulation import simulate_survey
from mlsroad_pipeline.simulation.parameters.presets import simulation_parameters

DATA = Path(os.environ.get("MLSROAD_DATA", Path(__file__).resolve().parents[2] / "shared/data"))
COMMON = ("ground", "building", "vegetation", "pole", "sign", "vehicle", "person", "wire", "other")
OF_SCHEME = {
    "paved ground": "ground", "natural ground": "ground", "tree": "vegetation", "low vegetation": "vegetation",
    "building": "building", "wall or fence": "other", "pole": "pole", "sign": "sign", "wire": "wire",
    "vehicle": "vehicle", "two-wheeler": "vehicle", "person": "person", "street furniture": "other",
}  # fmt: skip
"""Common class of each class of `road_inventory`."""

PREDICTED: dict[str, dict[str, Any]] = {
    "dense": {
        "survey": {"preset": "tiny", "seed": 11},
        "part": lambda cloud: np.arange(len(cloud)) < 9000,
    },
    "sparse": {
        "survey": {"preset": "hdl64", "seed": 12, "length": 10, "pulse_rate": 250_000},
        "part": lambda cloud: (cloud["gps_time"] - cloud["gps_time"][0]) // 0.1 == 5,
    },
}
"""Street and part of it whose labels the tests compare."""

PREFIXES = {
    "kitti": ("semantickitti_more/makeonebug", "SemanticKITTI, 3 scans of sequence 00"),
    "kitti_thinned": ("semantickitti_ika", "SemanticKITTI, 21 thinned scans of sequence 00"),
    "pandaset": ("pandaset/", "PandaSet, 4 frames"),
    "ika": ("ika_vehicle_lidar", "ika, 32 frames of 32 beams"),
}


def oakland(scheme_of: NDArray[np.int64]) -> Iterator[tuple[PointCloud, NDArray[np.int64]]]:
    """Yield the blocks of Oakland with their common classes, -1 for none."""
    codings, survey = configured("classes")["codings"], configured("survey", "oakland")
    coding = Coding("oakland", codings[survey["coding"]])
    options = ReadOptions.from_config({**survey["read"], "coding": coding})
    scheme = bundle_scheme(load_shipped("dense"))
    for path in sorted((DATA / "oakland").glob("*.xyz_label_conf.gz")):
        cloud = get_format(path).read(path, options)
        truth = scheme.encode(cloud["label"], source=cloud.source)
        yield cloud.without_columns(["label"]), np.append(scheme_of, -1)[truth]


def frames(prefix: str) -> Iterator[tuple[PointCloud, NDArray[np.int64]]]:
    """Yield the frames of a recording in real/ with their common classes, -1 for none."""
    spec = importlib.util.spec_from_file_location("load", DATA / "real/load.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    number = np.array([COMMON.index(name) if name in COMMON else -1 for name in module.CLASSES])
    for name, xyz, attributes, truth in module.clouds(prefix):
        intensity = np.asarray(attributes["intensity"], np.float32)
        intensity = intensity / (255 if intensity.max(initial=0) > 1 else 1)
        origin = np.floor(xyz.min(axis=0))
        yield PointCloud(xyz - origin, {"intensity": intensity}, origin, source=name), number[truth]


def score(name: str, data: str, variants: dict[str, list[str]]) -> dict[str, NDArray[np.int64]]:
    """Return the confusion matrix of a model on a recording, with and without its intensity."""
    bundle = load_shipped(name)
    scheme_of = np.array([COMMON.index(OF_SCHEME[c]) for c in bundle.classes])
    scenes = oakland(scheme_of) if data == "oakland" else frames(PREFIXES[data][0])
    totals = {key: np.zeros((len(COMMON), len(COMMON) + 1), np.int64) for key in variants}
    densities = []
    for cloud, truth in scenes:
        densities.append(merge([inspect_chunk(cloud)]).median_density)
        for key, removed in variants.items():
            label, _ = label_cloud(bundle, cloud.without_columns([c for c in removed if c in cloud]))
            totals[key] += confusion_matrix(truth, np.append(scheme_of, -1)[label], len(COMMON))
    print(f"{data}: median densities {np.round(np.sort(densities), 1).tolist()}", flush=True)
    return totals


def write_predictions(folder: Path) -> None:
    """Write points of simulated streets, in millimetres, and the labels that each model gives them."""
    for name, street in PREDICTED.items():
        cloud = simulate_survey(simulation_parameters(street["survey"])).cloud
        cloud = cloud.select(np.flatnonzero(street["part"](cloud)))
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
    """Score and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--models", nargs="+", default=list(shipped_models()))
    parser.add_argument("--data", nargs="+", default=["oakland", *PREFIXES])
    parser.add_argument("--record", action="store_true")
    parser.add_argument("--facts", nargs="+", metavar="FILE")
    parser.add_argument("--predictions", type=Path, metavar="FOLDER")
    options = parser.parse_args()
    logging.disable(logging.WARNING)  # one warning per frame that has no colour
    if options.predictions:
        write_predictions(options.predictions)
        return
    for path in options.facts or ():
        choice = explain_choice(path)
        print(f"{path}: {choice.name}: {choice.reason}")
    for name in () if options.facts else options.models:
        rows = []
        for data in options.data:
            variants = {"": []} if data == "oakland" else {", intensity": [], ", without intensity": ["intensity"]}
            for key, matrix in score(name, data, variants).items():
                found = scores(matrix)
                title = "Oakland, 11 blocks" if data == "oakland" else PREFIXES[data][1] + key
                f1 = {
                    c: round(float(v), 4) if matrix[i].sum() else None
                    for i, (c, v) in enumerate(zip(COMMON, found.f1, strict=True))
                }
                mean = float(np.mean([v for v in f1.values() if v is not None]))
                row = ModelScores(
                    title, int(matrix.sum()), round(found.overall_accuracy, 4), round(mean, 4), f1,
                    "python benchmarks/shipped_models.py",
                )  # fmt: skip
                rows.append(row)
                print(name, json.dumps(row.__dict__), flush=True)
        if options.record:
            entry = shipped_models()[name]
            kept = [row for row in entry.scores if row.data not in {new.data for new in rows}]
            save_entry(replace(entry, scores=(*kept, *rows)))


if __name__ == "__main__":
    main()

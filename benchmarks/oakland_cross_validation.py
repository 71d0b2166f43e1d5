"""Leave one block out over all blocks of Oakland 3-D: how well the detrended forest labels blocks that it has not seen.

    python benchmarks/oakland_cross_validation.py [FOLDER] [--seeds 2019 1 2] [--blocks part2] [--without-detrending]

FOLDER holds the blocks (*.xyz_label_conf.gz); by default it is $MLSROAD_DATA/oakland. Parameters are those of conf/base
and conf/oakland. Each block is labelled by a forest trained on all others, and the confusion matrices of all blocks are
added. Prints a table, and a JSON line per block and for all of them.
"""

from __future__ import annotations

import argparse
import json
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from mlsroad_pipeline.algorithms.classes import ClassScheme, Coding
from mlsroad_pipeline.algorithms.detrended_forest.labeller import StageParameters, label_scene
from mlsroad_pipeline.algorithms.detrended_forest.training import ForestParameters, fit, training_rows
from mlsroad_pipeline.algorithms.metrics.confusion import confusion_matrix, scores
from mlsroad_pipeline.algorithms.scene_stages import (
    FeatureParameters,
    GroundParameters,
    SupervoxelParameters,
    build_supervoxels,
    describe_supervoxels,
    find_ground,
)
from mlsroad_pipeline.datasets.formats.options import ReadOptions
from mlsroad_pipeline.datasets.formats.registry import get_format

CONF = Path(__file__).resolve().parents[1] / "conf"
SUFFIX = ".xyz_label_conf.gz"


def configured(group: str) -> dict[str, Any]:
    """Return a group of parameters as the environment oakland has it."""
    base = yaml.safe_load((CONF / f"base/parameters_{group}.yml").read_text(encoding="utf-8"))[group]
    own = yaml.safe_load((CONF / "oakland/parameters.yml").read_text(encoding="utf-8")).get(group, {})
    return {**base, **own}


def prepare(path: Path, stages: StageParameters, coding: Coding) -> dict[str, Any]:
    """Read a block and run the stages before the forest."""
    scene = get_format(path).read(path, ReadOptions.from_config({**configured("survey")["read"], "coding": coding}))
    ground = find_ground(scene, stages.ground)
    supervoxels = build_supervoxels(scene, stages.supervoxels)
    features = describe_supervoxels(scene, ground, supervoxels, stages.features)
    return {"scene": scene, "supervoxels": supervoxels, "features": features}


def report(block: str, seed: int, matrix: np.ndarray, scheme: ClassScheme) -> None:
    """Print a row of the table, and the same as JSON."""
    found = scores(matrix)
    f1 = {name: round(float(value), 4) for name, value in zip(scheme.classes, found.f1, strict=True)}
    print(f"{block:10s} seed {seed:<5d} OA {found.overall_accuracy:.4f}  mean F1 {found.mean_f1:.4f}  {f1}")
    row = {"block": block, "seed": seed, "overall_accuracy": found.overall_accuracy, "mean_f1": found.mean_f1, "f1": f1}
    print(json.dumps(row), flush=True)


def cross_validate(
    blocks: dict[str, dict[str, Any]], stages: StageParameters, forest: ForestParameters, scheme: ClassScheme
) -> None:
    """Label each block by a forest that was trained on the others."""
    rows = {name: training_rows(**block, scheme=scheme) for name, block in blocks.items()}
    total = np.zeros((len(scheme), len(scheme) + 1), np.int64)
    for name, block in blocks.items():
        others = [row for other, row in rows.items() if other != name]
        bundle, _ = fit(
            others, parameters=forest, stages=stages, scheme=scheme, trained_on={}, n_jobs=os.cpu_count() or 1
        )
        predicted = label_scene(**block, bundle=bundle)["label"]
        truth = scheme.encode(block["scene"]["label"], source=name)
        matrix = confusion_matrix(truth, predicted, len(scheme))
        report(name, forest.seed, matrix, scheme)
        total += matrix
    report("all", forest.seed, total, scheme)


def main() -> None:
    """Run the cross-validation that the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    default = Path(os.environ.get("MLSROAD_DATA", CONF.parents[1] / "shared/data")) / "oakland"
    parser.add_argument("folder", nargs="?", type=Path, default=default)
    parser.add_argument("--seeds", type=int, nargs="+", default=[configured("detrended_forest")["seed"]])
    parser.add_argument("--blocks", default="", help="only blocks whose name holds this")
    parser.add_argument("--without-detrending", action="store_true")
    arguments = parser.parse_args()
    files = [path for path in sorted(arguments.folder.glob(f"*{SUFFIX}")) if arguments.blocks in path.name]
    if len(files) < 2:
        parser.error(f"{arguments.folder} has {len(files)} files *{arguments.blocks}*{SUFFIX}: two are needed")
    features = FeatureParameters(**configured("features"))
    stages = StageParameters(
        GroundParameters(**configured("ground_removal")),
        SupervoxelParameters(**configured("supervoxelise")),
        replace(features, detrend=features.detrend and not arguments.without_detrending),
    )
    classes, survey = configured("classes"), configured("survey")
    scheme = ClassScheme.from_config(survey["scheme"], classes["schemes"][survey["scheme"]])
    coding = Coding("oakland", classes["codings"]["oakland"])
    blocks = {path.name.removesuffix(SUFFIX).removeprefix("oakland_"): prepare(path, stages, coding) for path in files}
    for seed in arguments.seeds:
        cross_validate(blocks, stages, ForestParameters(**{**configured("detrended_forest"), "seed": seed}), scheme)


if __name__ == "__main__":
    main()

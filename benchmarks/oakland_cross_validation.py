"""Leave one block out over all blocks of Oakland 3-D: how well the detrended forest labels blocks that it has not seen.

    python benchmarks/oakland_cross_validation.py [FOLDER] [--seeds 2019 1 2] [--blocks part2] [--without-detrending]

FOLDER holds the blocks (*.xyz_label_conf.gz); by default it is $MLSROAD_DATA/oakland. Parameters are those of conf/base
and conf/oakland. Each block is labelled by a forest trained on all others, and the confusion matrices of all blocks are
added. Prints a table, and a JSON line per block and for all of them.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path
from typing import Any

import numpy as np
from forest_trials import CONF, configured, configured_scheme, configured_stages, prepare, report

from mlsroad_pipeline.algorithms.core.classes import ClassScheme, Coding
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.detrended_forest.labeller import StageParameters, label_scene
from mlsroad_pipeline.algorithms.detrended_forest.training import ForestParameters, fit, training_rows
from mlsroad_pipeline.algorithms.metrics.confusion import confusion_matrix
from mlsroad_pipeline.formats.options import ReadOptions
from mlsroad_pipeline.formats.registry import get_format

ENVIRONMENT = "oakland"
SUFFIX = ".xyz_label_conf.gz"


def read(path: Path, coding: Coding) -> PointCloud:
    """Read a block as the environment oakland does."""
    options = ReadOptions.from_config({**configured("survey", ENVIRONMENT)["read"], "coding": coding})
    return get_format(path).read(path, options)


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
    forest = configured("detrended_forest", ENVIRONMENT)
    parser.add_argument("--seeds", type=int, nargs="+", default=[forest["seed"]])
    parser.add_argument("--blocks", default="", help="only blocks whose name holds this")
    parser.add_argument("--without-detrending", action="store_true")
    arguments = parser.parse_args()
    files = [path for path in sorted(arguments.folder.glob(f"*{SUFFIX}")) if arguments.blocks in path.name]
    if len(files) < 2:
        parser.error(f"{arguments.folder} has {len(files)} files *{arguments.blocks}*{SUFFIX}: two are needed")
    stages = configured_stages(ENVIRONMENT, detrend=not arguments.without_detrending)
    scheme = configured_scheme(configured("survey", ENVIRONMENT)["scheme"], ENVIRONMENT)
    coding = Coding("oakland", configured("classes", ENVIRONMENT)["codings"]["oakland"])
    names = [path.name.removesuffix(SUFFIX).removeprefix("oakland_") for path in files]
    blocks = {name: prepare(read(path, coding), stages) for name, path in zip(names, files, strict=True)}
    for seed in arguments.seeds:
        cross_validate(blocks, stages, ForestParameters(**{**forest, "seed": seed}), scheme)


if __name__ == "__main__":
    main()

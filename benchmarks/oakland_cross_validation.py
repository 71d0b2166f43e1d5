"""Leave one block out over all blocks of Oakland 3-D: how well a labeller labels blocks that it has not seen.

    python benchmarks/oakland_cross_validation.py [FOLDER] [--method detrended_forest] [--seeds 2019 1 2]

FOLDER holds the blocks (*.xyz_label_conf.gz); by default it is $MLSROAD_DATA/oakland. Parameters are those of conf/base
and conf/oakland. The method is detrended_forest or boosted_trees. Each block is labelled by a model of all others, and
the confusion matrices of all blocks are added. Prints a table, and a JSON line per block and for all of them.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from _common import DATA, configured, configured_scheme, configured_stages, parser, prepare, report

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.core.codings import Coding
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.stage_parameters import GroundParameters
from mlsroad_pipeline.algorithms.metrics.confusion import confusion_matrix
from mlsroad_pipeline.algorithms.models.boosted_trees.labeller import label_scene as label_voxels
from mlsroad_pipeline.algorithms.models.boosted_trees.parameters import SLUG as TREES
from mlsroad_pipeline.algorithms.models.boosted_trees.parameters import BoostedTreesParameters
from mlsroad_pipeline.algorithms.models.boosted_trees.sampling import training_voxels
from mlsroad_pipeline.algorithms.models.boosted_trees.training import fit as fit_trees
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.stages import find_ground
from mlsroad_pipeline.formats.options import ReadOptions
from mlsroad_pipeline.formats.registry import get_format
from mlsroad_pipeline.papers.tomic2019.detrended_forest.labeller import label_scene
from mlsroad_pipeline.papers.tomic2019.detrended_forest.training import ForestParameters, fit, training_rows
from mlsroad_pipeline.pipelines.boosted_trees import load_lightgbm

ENVIRONMENT = "oakland"
SUFFIX = ".xyz_label_conf.gz"


def files_of(folder: Path) -> list[Path]:
    """Return the files of the blocks; at least two are needed."""
    files = sorted(folder.glob(f"*{SUFFIX}"))
    if len(files) < 2:
        raise SystemExit(f"{folder} has {len(files)} files *{SUFFIX}; at least two are needed")
    return files


def read_blocks(files: list[Path]) -> dict[str, PointCloud]:
    """Read blocks as the environment oakland does."""
    coding = Coding("oakland", configured("classes", ENVIRONMENT)["codings"]["oakland"])
    options = ReadOptions.from_config({**configured("survey", ENVIRONMENT)["read"], "coding": coding})
    return {
        path.name.removesuffix(SUFFIX).removeprefix("oakland_"): get_format(path).read(path, options) for path in files
    }


@dataclass(frozen=True)
class Trial:
    """A method on the blocks: samples of a block, a model of samples and a seed, labels of a block by a model."""

    samples: dict[str, Any]
    train: Callable[[list[Any], int], ModelBundle]
    label: Callable[[str, ModelBundle], np.ndarray]


def forest_trial(clouds: Mapping[str, PointCloud], scheme: ClassScheme) -> Trial:
    """Return the trial of the detrended forest."""
    stages = configured_stages(ENVIRONMENT)
    blocks = {name: prepare(cloud, stages) for name, cloud in clouds.items()}
    parameters = configured("detrended_forest", ENVIRONMENT)

    def train(samples: list[Any], seed: int) -> ModelBundle:
        own = ForestParameters(**{**parameters, "seed": seed})
        return fit(samples, parameters=own, stages=stages, scheme=scheme, trained_on={}, n_jobs=os.cpu_count() or 1)[0]

    samples = {name: training_rows(**block, scheme=scheme) for name, block in blocks.items()}
    return Trial(samples, train, lambda name, bundle: label_scene(**blocks[name], bundle=bundle)["label"])


def trees_trial(clouds: Mapping[str, PointCloud], scheme: ClassScheme) -> Trial:
    """Return the trial of the boosted trees."""
    load_lightgbm()
    filtered = GroundParameters(**configured("ground_removal", ENVIRONMENT))
    ground = {name: find_ground(cloud, filtered) for name, cloud in clouds.items()}
    parameters = BoostedTreesParameters(**configured(TREES, ENVIRONMENT))

    def train(samples: list[Any], seed: int) -> ModelBundle:
        own = replace(parameters, seed=seed)
        return fit_trees(
            samples, parameters=own, ground=filtered, scheme=scheme, trained_on={}, n_threads=os.cpu_count() or 1
        )

    samples = {
        name: training_voxels(cloud, ground[name], parameters=parameters.of_sample(), scheme=scheme)
        for name, cloud in clouds.items()
    }
    return Trial(samples, train, lambda name, bundle: label_voxels(clouds[name], ground[name], bundle)["label"])


def cross_validate(trial: Trial, clouds: Mapping[str, PointCloud], scheme: ClassScheme, seed: int) -> None:
    """Label each block by a model that was trained on the others."""
    total = np.zeros((len(scheme), len(scheme) + 1), np.int64)
    for name, cloud in clouds.items():
        bundle = trial.train([rows for other, rows in trial.samples.items() if other != name], seed)
        truth = scheme.encode(cloud["label"], source=name)
        matrix = confusion_matrix(truth, trial.label(name, bundle), len(scheme))
        report(name, seed, matrix, scheme)
        total += matrix
    report("all", seed, total, scheme)


def main() -> None:
    """Run the cross-validation that the command line asks for."""
    arguments = parser(__doc__)
    arguments.add_argument("folder", nargs="?", type=Path, default=DATA / "oakland")
    arguments.add_argument("--method", choices=["detrended_forest", TREES], default="detrended_forest")
    arguments.add_argument("--seeds", type=int, nargs="+")
    options = arguments.parse_args()
    clouds = read_blocks(files_of(options.folder))
    scheme = configured_scheme(configured("survey", ENVIRONMENT)["scheme"], ENVIRONMENT)
    trial = trees_trial(clouds, scheme) if options.method == TREES else forest_trial(clouds, scheme)
    for seed in options.seeds or [configured(options.method, ENVIRONMENT)["seed"]]:
        cross_validate(trial, clouds, scheme, seed)


if __name__ == "__main__":
    main()

"""The six labellers of Luo et al. 2016 on Oakland 3-D, every setting chosen on training blocks alone.

    python benchmarks/oakland_splits.py [FOLDER] [--splits conf exchanged 1 2 3] [--methods patch_graph ...]
        [--patches 0 4]

FOLDER holds the blocks (*.xyz_label_conf.gz); by default it is $MLSROAD_DATA/oakland. The split ``conf`` is that of
conf/oakland, ``exchanged`` has training and test blocks exchanged, a number is the seed of a draw of as many training
blocks. For each split the training blocks are dealt to three folds, and each fold is labelled by methods that were
trained on the other two. The highest overall accuracy of their points chooses

1. the patches, which all methods share: the mean of `patch_forest` and of `patch_graph_mrf` with its best lambda;
2. the setting of each method, among `SETTINGS`. `patch_svm` and `patch_graph_mrf` choose C, gamma and lambda by
   themselves in training, by cross-validation over blocks.

Then all training blocks train the methods, and the test blocks are labelled once. All else is as in conf/base and
conf/oakland. Prints what was tried and the scores, and a JSON line per split and method.
"""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

import numpy as np
from forest_trials import CONF, configured, configured_scheme
from oakland_cross_validation import ENVIRONMENT, SUFFIX, read

from mlsroad_pipeline.algorithms.core.codings import Coding
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.stage_parameters import GroundParameters
from mlsroad_pipeline.algorithms.metrics.confusion import confusion_matrix, scores
from mlsroad_pipeline.algorithms.stages import find_ground
from mlsroad_pipeline.papers.luo2016.max_margin_markov.training import MarginParameters
from mlsroad_pipeline.papers.luo2016.patch_forest.classifier import PatchForestParameters
from mlsroad_pipeline.papers.luo2016.patch_graph.classifier import PatchGraphClassifier, PatchGraphParameters
from mlsroad_pipeline.papers.luo2016.patch_graph.labeller import ground_classes
from mlsroad_pipeline.papers.luo2016.patch_graph.refined_classifier import GridParameters
from mlsroad_pipeline.papers.luo2016.patch_graph.refinement import RefinementParameters, refine
from mlsroad_pipeline.papers.luo2016.patch_svm.classifier import PatchSvmParameters
from mlsroad_pipeline.papers.luo2016.shape_based.labeller import ShapeParameters
from mlsroad_pipeline.papers.luo2016.study.runs import cut_patches, train_and_score
from mlsroad_pipeline.papers.shared.patches.extraction import PatchParameters
from mlsroad_pipeline.papers.shared.patches.table import Patches
from mlsroad_pipeline.papers.shared.patches.training import join_training_scenes
from mlsroad_pipeline.papers.shared.patches.types import PatchStages
from mlsroad_pipeline.papers.shared.patches.voting import vote_on_points
from mlsroad_pipeline.papers.shared.studies.parameters import changed

N_FOLDS = 3
TYPES: dict[str, Any] = {
    "patch_forest": PatchForestParameters,
    "patch_svm": PatchSvmParameters,
    "shape_based": ShapeParameters,
    "max_margin_markov": MarginParameters,
    "patch_graph": PatchGraphParameters,
    "patch_graph_mrf": GridParameters,
}
RUNS = tuple(TYPES)[:-1]  # the graph gives its refinement too
PATCHES = [  # edge of a patch; its voxels, normals and histograms
    {"patch_size": 0.2, "voxel_size": 0.1, "normal_radius": 0.3, "fpfh_radius": 0.8},  # conf/base
    {"patch_size": 0.3, "voxel_size": 0.15, "normal_radius": 0.5, "fpfh_radius": 1.6},
    {"patch_size": 0.4, "voxel_size": 0.2, "normal_radius": 0.5, "fpfh_radius": 1.6},
    {"patch_size": 0.4, "voxel_size": 0.2, "normal_radius": 0.8, "fpfh_radius": 1.6},
    {"patch_size": 0.5, "voxel_size": 0.25, "normal_radius": 0.5, "fpfh_radius": 1.6},
    {"patch_size": 0.5, "voxel_size": 0.25, "normal_radius": 0.8, "fpfh_radius": 1.6},
    {"patch_size": 0.6, "voxel_size": 0.3, "normal_radius": 0.8, "fpfh_radius": 1.6},
]
SETTINGS: dict[str, list[dict[str, Any]]] = {
    "patch_forest": [
        {"max_depth": 15, "max_per_class": 10_000},
        {"max_depth": 10, "max_per_class": 10_000},
        {"max_depth": 20, "max_per_class": 10_000},
        {"max_depth": 15, "max_per_class": 3_000},
    ],
    "shape_based": [
        {"spacing": 0.6, "background": 0.05},
        {"spacing": 0.6, "background": 0.1},
        {"spacing": 1.0, "background": 0.05},
        {"spacing": 1.0, "background": 0.1},
    ],
    "max_margin_markov": [{"class_weight": "sqrt"}, {"class_weight": "none"}],
    "patch_graph": [{"weights": {"max_height": 20.0}}, {"weights": {"max_height": 5.0}}],
}
Block = dict[str, Any]


class Trials:
    """The blocks of a folder, cut into patches of any size when they are asked for."""

    def __init__(self, folder: Path) -> None:
        survey, classes = configured("survey", ENVIRONMENT), configured("classes", ENVIRONMENT)
        coding = Coding(survey["coding"], classes["codings"][survey["coding"]])
        self.scheme = configured_scheme(survey["scheme"], ENVIRONMENT)
        self.ground = GroundParameters(**configured("ground_removal", ENVIRONMENT))
        self.sizes = PatchParameters(**configured("patches", ENVIRONMENT))
        self.parameters = {slug: kind(**configured(slug, ENVIRONMENT)) for slug, kind in TYPES.items()}
        self.points: dict[str, PointCloud] = {}
        self._cut: dict[PatchParameters, dict[str, Block]] = {}
        for path in sorted(folder.glob(f"*{SUFFIX}")):
            cloud = read(path, coding)
            self.points[path.name] = cloud.with_columns(**find_ground(cloud, self.ground))

    def blocks(self, sizes: PatchParameters, names: Sequence[str]) -> dict[str, Block]:
        """Return blocks with their patches."""
        known = self._cut.setdefault(sizes, {})
        for name in names:
            if name not in known:
                points = self.points[name]
                known[name] = {"points": points, **cut_patches(points, sizes=sizes, scheme=self.scheme)}
        return {name: known[name] for name in names}

    def folds(self, blocks: Mapping[str, Block]) -> Iterator[tuple[dict[str, Block], dict[str, Block]]]:
        """Yield the blocks to train on and those held out."""
        names = sorted(blocks)
        for first in range(N_FOLDS):
            held = names[first::N_FOLDS]
            yield {n: b for n, b in blocks.items() if n not in held}, {n: blocks[n] for n in held}

    def score(
        self, train: dict[str, Block], test: dict[str, Block], method: str, sizes: PatchParameters, setting: dict
    ) -> dict[str, np.ndarray]:
        """Train on blocks and return the confusion matrices of others; the graph's refinement comes with it."""
        parameters = {**self.parameters, method: changed(self.parameters[method], setting)}
        stages = PatchStages(self.ground, sizes)
        found = train_and_score(train, test, method=method, parameters=parameters, stages=stages, scheme=self.scheme)
        print(found["facts"].to_string(index=False), flush=True)
        return {slug: matrices.sum(axis=0) for slug, matrices in found["matrices"].items()}

    def held_out(self, blocks: dict[str, Block], method: str, sizes: PatchParameters, setting: dict) -> float:
        """Return the overall accuracy of a setting on held-out training blocks."""
        if method == "patch_graph":
            return max(self.graph_held_out(blocks, setting, refined=False).values())
        matrices = [self.score(train, held, method, sizes, setting)[method] for train, held in self.folds(blocks)]
        return accuracy(sum(matrices))

    def graph_held_out(self, blocks: dict[str, Block], setting: dict, *, refined: bool) -> dict[float, float]:
        """Return the overall accuracy of the graph on held-out training blocks for every lambda, 0 alone unrefined."""
        parameters = changed(self.parameters["patch_graph"], setting)
        grid, ground = self.parameters["patch_graph_mrf"], ground_classes(self.scheme)
        lambdas = grid.smoothness if refined else (0.0,)
        base = RefinementParameters(0.0, 0.0, grid.ground_penalty, grid.floor, grid.smooth_ground)
        totals = {value: np.zeros((len(self.scheme), len(self.scheme) + 1), np.int64) for value in lambdas}
        for train, held in self.folds(blocks):
            joined = join_training_scenes(*({n: b[k] for n, b in train.items()} for k in ("patches", "labels")))
            graph = PatchGraphClassifier.fit(*joined, len(self.scheme), parameters=parameters)
            for name, block in held.items():
                patches, edges = Patches.from_arrays(block["patches"]), block["patches"]["edges"]
                votes = graph.predict_proba(patches, edges)
                truth = self.scheme.encode(block["points"]["label"], source=name)
                for value in lambdas:
                    field = refine(votes, None, edges, parameters=replace(base, smoothness=value), ground=ground)[1]
                    labels = vote_on_points(
                        block["points"].xyz, patches.centroid, field, radius=self.sizes.area_radius
                    )[0]
                    totals[value] += confusion_matrix(truth, labels, len(self.scheme))
        return {value: accuracy(total) for value, total in totals.items()}

    def choose_patches(self, names: Sequence[str], tried: Sequence[int]) -> PatchParameters:
        """Return the patches that serve the forest and the refined graph best on held-out training blocks."""
        best, chosen = -1.0, self.sizes
        for setting in [PATCHES[number] for number in tried]:
            sizes = changed(self.sizes, setting)
            blocks = self.blocks(sizes, names)
            forest = self.held_out(blocks, "patch_forest", sizes, SETTINGS["patch_forest"][0])
            graph = self.graph_held_out(blocks, {}, refined=True)
            told = " ".join(f"{value:g}: {share:.4f}" for value, share in graph.items())
            print(f"{setting}: forest {forest:.4f}; refined graph by lambda {told}", flush=True)
            if (forest + max(graph.values())) / 2 > best:
                best, chosen = (forest + max(graph.values())) / 2, sizes
        return chosen

    def choose_setting(self, blocks: dict[str, Block], method: str, sizes: PatchParameters) -> dict[str, Any]:
        """Return the setting of a method that does best on held-out training blocks, of equal ones the first."""
        settings = SETTINGS.get(method, [{}])
        if len(settings) == 1:
            return settings[0]
        found = [self.held_out(blocks, method, sizes, setting) for setting in settings]
        for setting, share in zip(settings, found, strict=True):
            print(f"{method} {setting}: {share:.4f}", flush=True)
        return settings[int(np.argmax(found))]


def accuracy(matrix: np.ndarray) -> float:
    """Return the overall accuracy over the points that a method gives a label to."""
    return float(np.trace(matrix) / matrix[:, : len(matrix)].sum())


def split_blocks(split: str, names: Sequence[str]) -> tuple[list[str], list[str]]:
    """Return the training and the test blocks of a split."""
    patterns = configured("survey", ENVIRONMENT)["splits"]
    train = [name for name in names if fnmatch(name, patterns["train"])]
    if split.isdigit():
        train = sorted(np.random.default_rng(int(split)).permutation(names)[: len(train)].tolist())
    test = [name for name in names if name not in train]
    return (test, train) if split == "exchanged" else (train, test)


def main() -> None:
    """Choose, train, score and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    default = Path(os.environ.get("MLSROAD_DATA", CONF.parents[1] / "shared/data")) / "oakland"
    parser.add_argument("folder", nargs="?", type=Path, default=default)
    parser.add_argument("--splits", nargs="+", default=["conf", "exchanged", "1", "2", "3"])
    parser.add_argument("--methods", nargs="+", choices=RUNS, default=list(RUNS))
    every = range(len(PATCHES))
    parser.add_argument(
        "--patches", nargs="+", type=int, choices=every, default=list(every), help="places in `PATCHES`"
    )
    options = parser.parse_args()
    trials = Trials(options.folder)
    for split in options.splits:
        train, test = split_blocks(split, list(trials.points))
        print(f"\nsplit {split}: trained on {', '.join(train)}", flush=True)
        sizes = trials.choose_patches(train, options.patches)
        blocks = trials.blocks(sizes, train)
        settings = {method: trials.choose_setting(blocks, method, sizes) for method in options.methods}
        for method, setting in settings.items():
            for slug, matrix in trials.score(blocks, trials.blocks(sizes, test), method, sizes, setting).items():
                found = scores(matrix)
                f1 = {c: round(float(v), 3) for c, v in zip(trials.scheme.classes, found.f1, strict=True)}
                row = {
                    "split": split, "method": slug, "overall_accuracy": round(found.overall_accuracy, 4),
                    "mean_f1": round(found.mean_f1, 4), "f1": f1, "patches": sizes.patch_size,
                    "normals": sizes.normal_radius, "histograms": sizes.fpfh_radius, "setting": setting,
                    "matrix": matrix.tolist(),
                }  # fmt: skip
                print(json.dumps(row), flush=True)


if __name__ == "__main__":
    main()

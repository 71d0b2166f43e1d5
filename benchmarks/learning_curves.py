"""Gain by a few answers of a user: mean IoU after 10, 50 and 200 answers, in the order of review and at random.

    kedro run --env=recordings
    python benchmarks/learning_curves.py [--sources NAME...] [--seeds 0 1 2 3 4] [--answers 10 50 200] [--json FILE]
        [--unseen FOLDER] [--model pool]

A simulated user answers from the reference of the recordings of conf/recordings. An answer is one segment of the
training part (`boosted_trees.segments`): its class, if at least 80 % of its labelled points are of one common class,
else "mixed", which counts as an answer and teaches nothing. The model learns from the answers as `mlsroad learn` does.
It is scored on the test part, of which nothing is ever shown: mean IoU over the common classes that the recording has.
A random order draws from the same segments. The order of review is made anew at 10 and at 50 answers.

The model is the shipped `general`; for PandaSet and ika, which it was trained on, a model of simulated streets alone.
With `--model pool` the trees of the shipped pool learn; their voxels get the mean probabilities of the network's
superpoints, and both are pooled as in the pool. `--unseen` names the folder of the model of streets alone, which is
filled by training on `data/05_model_input/general` (`kedro run --env=general`) if it is missing; 20 minutes of one
core.
"""

from __future__ import annotations

import json
import logging
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from _common import CONF, REPOSITORY, configured, configured_scheme, parser
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.stage_parameters import GroundParameters
from mlsroad_pipeline.algorithms.features.voxel_scales import VoxelFeatures, smooth_by_cells
from mlsroad_pipeline.algorithms.metrics.confusion import scores
from mlsroad_pipeline.algorithms.models.boosted_trees.answer_boosting import Answer
from mlsroad_pipeline.algorithms.models.boosted_trees.corrected import continue_training
from mlsroad_pipeline.algorithms.models.boosted_trees.labeller import describe_scene, softmax
from mlsroad_pipeline.algorithms.models.boosted_trees.parameters import SLUG, BoostedTreesParameters
from mlsroad_pipeline.algorithms.models.boosted_trees.segments import (
    LEAST,
    Segments,
    find_segments,
    order_of_questions,
)
from mlsroad_pipeline.algorithms.models.boosted_trees.training import fit
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.models.labelling import label_softly
from mlsroad_pipeline.algorithms.models.machines.boosted_trees import BoostedTrees
from mlsroad_pipeline.algorithms.models.machines.combinations import decide
from mlsroad_pipeline.algorithms.models.pool.labeller import FLOOR, NETWORK, TREES, members_of
from mlsroad_pipeline.algorithms.scenes.parts import TEST, TRAIN
from mlsroad_pipeline.algorithms.stages import ground_of, inliers
from mlsroad_pipeline.execution.collection import SceneCollection
from mlsroad_pipeline.execution.store import SceneStore
from mlsroad_pipeline.model_store.bundle_files import load_bundle, save_bundle
from mlsroad_pipeline.model_store.object_classifiers import read_replay
from mlsroad_pipeline.model_store.shipped_models import load_shipped
from mlsroad_pipeline.papers.comparison.recordings.parameters import Source, sources_of
from mlsroad_pipeline.papers.comparison.recordings.scoring import unmixed
from mlsroad_pipeline.pipelines.boosted_trees import load_lightgbm

SCENES = "data/03_primary/recordings/recordings_study/scenes"
VOXELS = "data/05_model_input/general/boosted_trees/training_set"
TRAINED_ON = ("pandaset", "ika")
NETWORK_WEIGHT = 0.5
PURE, LEAST_POINTS, SAMPLED = 0.8, 100, 60_000
COMMON, FINE = configured_scheme("common"), configured_scheme("road_inventory")
GROUPS = np.asarray(FINE.coarsen(COMMON))
MEMBERS = GROUPS[None, :] == np.arange(len(COMMON))[:, None]


@dataclass
class Recording:
    """Voxels of a recording: points per common class in both parts, places in the frame of the drive, raw scores."""

    source: Source
    bundle: ModelBundle
    scenes: list[VoxelFeatures]
    values: NDArray[np.float32]
    xyz: NDArray[np.float64]
    shown: NDArray[np.bool_]
    answers: NDArray[np.int64]
    truth: NDArray[np.int64]
    lost: NDArray[np.int64]
    raw: NDArray[np.float64]
    network: NDArray[np.float64] | None
    """Weighted logarithms of the probabilities of the network in a pool; None for other models."""

    def probabilities(self, added: NDArray[np.float64] | float = 0.0) -> NDArray[np.float64]:
        """Return smoothed probabilities, as the labeller does."""
        found = softmax(self.raw + added)
        parameters = self.bundle.metadata["parameters"]["boosted_trees"]
        first = 0
        for scene in self.scenes:
            rows = slice(first, first + len(scene.cells))
            around = smooth_by_cells(scene, found[rows], level=parameters["smoothing_level"])
            found[rows] += parameters["smoothing"] * (around - found[rows])
            first = rows.stop
        if self.network is None:
            return found
        pooled = self.network + (1.0 - NETWORK_WEIGHT) * np.log(np.maximum(found, FLOOR))
        pooled = np.exp(pooled - pooled.max(axis=1, keepdims=True))
        result: NDArray[np.float64] = pooled / pooled.sum(axis=1, keepdims=True)
        return result

    def mean_iou(self, probabilities: NDArray[np.float64]) -> tuple[float, dict[str, float]]:
        """Return the mean IoU of the test part, and that of each class."""
        label = GROUPS[decide(probabilities, GROUPS)[0]]
        matrix = np.zeros((len(COMMON), len(COMMON) + 1), np.int64)
        for own in range(len(COMMON)):
            predicted = unmixed(np.full(len(label), own), label, COMMON, self.source.mixed)
            matrix[own, :-1] = np.bincount(predicted, weights=self.truth[:, own], minlength=len(COMMON))
        matrix[:, -1] = self.lost
        iou, counts = scores(matrix).iou, self.truth.sum(axis=0) + self.lost
        kept = {
            name: round(float(iou[i]), 3)
            for i, name in enumerate(COMMON.classes)
            if name in self.source.classes and name != "other" and counts[i] >= LEAST_POINTS
        }
        return float(np.mean([iou[COMMON.classes.index(name)] for name in kept])), kept


def read(source: Source, bundle: ModelBundle, folder: Path, network: ModelBundle | None = None) -> Recording:
    """Compute the voxels of all scenes of a recording, and what the network of a pool adds to the scores of each."""
    store = SceneStore(str(folder))
    records = {k: r for k, r in store.stored_records().items() if k.partition(".")[0] == source.name}
    ground = GroundParameters(**bundle.metadata["parameters"]["ground"])
    scenes, parts, lost = [], [], np.zeros(len(COMMON), np.int64)
    added: list[NDArray[np.float64]] = []
    for key, handle in SceneCollection(store, records).items():
        cloud = handle.load()
        plain = cloud.without_columns(["label", "part"])
        described = ground_of(plain, ground)
        found, keep = describe_scene(plain, described), inliers(plain)
        truth, part = COMMON.encode(cloud["label"], source=key), cloud["part"]
        world, pose = cloud.world_xyz()[keep], source.pose(key.partition(".")[2])
        if pose is not None:
            world[:, :2] = pose.placed(world[:, :2])
        n, points = len(found.cells), np.bincount(found.owner, minlength=len(found.cells))
        counts = [_counts(found.owner, np.where(part == which, truth, -1)[keep], n) for which in (TRAIN, TEST)]
        shown = np.bincount(found.owner, weights=part[keep] == TRAIN, minlength=n) > points / 2
        places = [np.bincount(found.owner, weights=world[:, axis], minlength=n) / points for axis in range(3)]
        lost += np.bincount(truth[(part == TEST) & ~keep & (truth >= 0)], minlength=len(COMMON))
        if network is not None:
            added.append(NETWORK_WEIGHT * _network_scores(plain, ground, network, keep, found))
        parts.append((found.values, np.stack(places, axis=1), shown, *counts))
        scenes.append(replace(found, values=found.values[:0]))
    values, xyz, shown, answers, truth = (np.concatenate(each) for each in zip(*parts, strict=True))
    raw = BoostedTrees.from_arrays(bundle.arrays).scores(values)
    joined = np.concatenate(added) if added else None
    return Recording(source, bundle, scenes, values, xyz, shown, answers, truth, lost, raw, joined)


def _network_scores(
    cloud: PointCloud, ground: GroundParameters, network: ModelBundle, keep: NDArray[np.bool_], voxels: VoxelFeatures
) -> NDArray[np.float64]:
    """Return the logarithms of the mean probabilities of the network in each voxel."""
    soft = label_softly(network, cloud.with_columns(**ground_of(cloud, ground)))
    if soft.probabilities is None or soft.owner is None:
        raise SystemExit(f"{cloud.source}: the network gives no probabilities")
    even = np.full(soft.probabilities.shape[1], 1 / soft.probabilities.shape[1])
    of_point = np.vstack([soft.probabilities, even])[soft.owner][keep]  # -1: no superpoint
    n = len(voxels.cells)
    sums = np.stack([np.bincount(voxels.owner, column, minlength=n) for column in of_point.T], axis=1)
    mean: NDArray[np.float64] = sums / np.bincount(voxels.owner, minlength=n)[:, None]
    return np.log(np.maximum(mean, FLOOR))


def _counts(owner: NDArray[np.int32], truth: NDArray[np.int64], n: int) -> NDArray[np.int64]:
    known = truth >= 0
    flat = owner[known].astype(np.int64) * len(COMMON) + truth[known]
    return np.bincount(flat, minlength=n * len(COMMON)).reshape(n, -1)


class User:
    """Simulated user of one recording, and the learning from the answers."""

    def __init__(self, recording: Recording) -> None:
        self.recording = recording
        self.rows = np.flatnonzero(recording.shown)
        self.replay = read_replay(load_shipped("general"))
        self.segments = self._segments(recording.probabilities())
        self.truth = np.stack(
            [np.bincount(self.segments.owner, weights=recording.answers[self.rows, c]) for c in range(len(COMMON))], 1
        )
        self.asked = np.flatnonzero(self.segments.size >= LEAST)

    def _segments(self, probabilities: NDArray[np.float64]) -> Segments:
        rows = self.rows
        of_groups = probabilities[rows] @ MEMBERS.T
        return find_segments(self.recording.xyz[rows], self.recording.values[rows], of_groups)

    def with_probabilities(self, probabilities: NDArray[np.float64]) -> Segments:
        """Return the same segments with the probabilities of another model."""
        owner, of_groups = self.segments.owner, probabilities[self.rows] @ MEMBERS.T
        sums = np.stack([np.bincount(owner, weights=column) for column in of_groups.T], 1)
        return self.segments._replace(probabilities=sums / self.segments.size[:, None])

    def learn(self, asked: list[int], seed: int) -> NDArray[np.float64]:
        """Return the scores that the added trees give to all voxels."""
        own, values = self.recording, self.recording.values
        answers = []
        for segment in asked:
            counts = self.truth[segment]
            if counts.sum() > 0 and counts.max() >= PURE * counts.sum():
                voxels = self.rows[self.segments.owner == segment]
                answers.append(Answer(values[voxels], MEMBERS[int(counts.argmax())], own.raw[voxels]))
        rng = np.random.default_rng(seed)
        rest = rng.permutation(self.rows[~np.isin(self.segments.owner, asked)])[:SAMPLED]
        model = continue_training(own.bundle, answers, values[rest], self.replay)
        return trees_after(model, own.bundle).scores(values)


def trees_after(model: ModelBundle, before: ModelBundle) -> BoostedTrees:
    """Return the trees of a model after those of another one."""
    both, old = (BoostedTrees.from_arrays(bundle.arrays) for bundle in (model, before))
    nodes = len(old.feature)
    tail = {name: getattr(both, name)[nodes:] for name in ("feature", "threshold", "missing_left", "left", "right")}
    return replace(
        both,
        **tail,
        n_leaves=both.n_leaves[len(old) :],
        tree_class=both.tree_class[len(old) :],
        leaf=both.leaf[len(old.leaf) :],
        initial=np.zeros_like(both.initial),
    )


def curves(user: User, steps: list[int], seed: int) -> dict[str, Any]:
    """Return the mean IoU and the IoU per class after each number of answers, by order."""
    out: dict[str, Any] = {}
    random = np.random.default_rng(seed).permutation(user.asked).tolist()
    for order in ("review", "random"):
        segments, asked = user.segments, []
        for number in steps:
            more = number - len(asked)
            if order == "random":
                asked = random[:number]
            else:
                asked += order_of_questions(segments, more, asked=asked, seed=seed).tolist()
            probabilities = user.recording.probabilities(user.learn(asked, seed))
            mean, iou = user.recording.mean_iou(probabilities)
            out[f"{order} {number}"] = {"mean_iou": round(mean, 4), "iou": iou}
            segments = user.with_probabilities(probabilities)
    return out


def unseen_model(folder: Path) -> ModelBundle:
    """Return the model of simulated streets alone; it is trained where the folder is missing."""
    if not folder.is_dir():
        load_lightgbm()
        store = SceneStore(str(REPOSITORY / VOXELS))
        voxels = list(SceneCollection(store, store.stored_records()).load_all().values())
        bundle = fit(
            voxels,
            parameters=BoostedTreesParameters(**configured(SLUG, "general")),
            ground=GroundParameters(**configured("ground_removal")),
            scheme=FINE,
            trained_on={},
            sources=["simulated"] * len(voxels),
            weights=[1.0] * len(voxels),
            groups=GROUPS.tolist(),
            n_threads=2,
        )
        save_bundle(bundle, folder)
    return load_bundle(folder)


def report(results: dict[str, Any], steps: list[int]) -> None:
    """Print a table: rows are recordings, columns numbers of answers in both orders, means over the seeds."""
    columns = [f"{order} {number}" for order in ("review", "random") for number in steps]
    print("| recording | 0 | " + " | ".join(columns) + " |")
    print("|---" * (len(columns) + 2) + "|")
    table = []
    for name, result in results.items():
        row = [np.mean([run[c]["mean_iou"] for run in result["seeds"].values()]) for c in columns]
        table.append([result["start"]["mean_iou"], *row])
        print(f"| {name} | " + " | ".join(f"{value:.3f}" for value in table[-1]) + " |")
    print("| mean | " + " | ".join(f"{value:.3f}" for value in np.mean(table, axis=0)) + " |")


def main() -> None:
    """Run the study that the command line asks for."""
    arguments = parser(__doc__)
    arguments.add_argument("--sources", nargs="*")
    arguments.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2, 3, 4])
    arguments.add_argument("--answers", type=int, nargs="+", default=[10, 50, 200])
    arguments.add_argument("--scenes", type=Path, default=REPOSITORY / SCENES)
    arguments.add_argument("--unseen", type=Path, default=REPOSITORY / "data/06_models/learning_curves/simulated")
    arguments.add_argument("--model", default="general", choices=("general", "pool"))
    arguments.add_argument("--json", type=Path, help="results; recordings and seeds that it holds are not run again")
    options = arguments.parse_args()
    logging.disable(logging.WARNING)
    study = yaml.safe_load((CONF / "recordings/parameters.yml").read_text(encoding="utf-8"))["recordings_study"]
    results = json.loads(options.json.read_text()) if options.json and options.json.exists() else {}
    for name, source in sources_of(study["sources"]).items():
        if options.sources is not None and name not in options.sources:
            continue
        missing = [seed for seed in options.seeds if str(seed) not in results.get(name, {}).get("seeds", {})]
        if not missing:
            continue
        shipped = load_shipped(options.model)
        members = members_of(shipped) if options.model == "pool" else {TREES: shipped}
        seen = name in TRAINED_ON
        bundle = unseen_model(options.unseen) if seen else members[TREES]
        user = User(read(source, bundle, options.scenes, members.get(NETWORK)))
        start = user.recording.probabilities()
        mean, iou = user.recording.mean_iou(start)
        result = results.setdefault(name, {"start": {"mean_iou": round(mean, 4), "iou": iou}, "seeds": {}})
        for seed in missing:
            begin = time.process_time()
            result["seeds"][str(seed)] = curves(user, options.answers, seed)
            print(
                name, seed, json.dumps(result["seeds"][str(seed)]), f"{time.process_time() - begin:.0f} s", flush=True
            )
            if options.json:
                options.json.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")
    report(results, options.answers)


if __name__ == "__main__":
    main()

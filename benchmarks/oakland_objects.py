"""Leave one block of Oakland 3-D out: poles, signs and vehicles found with labels, and scores, of models of the others.

    python benchmarks/oakland_objects.py [FOLDER] [--candidates STORE] [--weight 10]

FOLDER holds the blocks and objects.csv; by default it is $MLSROAD_DATA/oakland. Each block is labelled by boosted trees
of the ten others. Its candidates are scored by the shipped object classifier. With `--candidates`, they are also scored
by classifiers trained on the candidates of simulated streets and, with `--weight`, on those of the ten other blocks;
STORE is the store of the pipeline, data/05_model_input/general/object_classifier/candidates. The trees that classify
upright lines are the shipped ones. Objects with a score from 0.4 count; distances are 0.5 m, and 2 m for vehicles,
whose reference is the mean of the seen side.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
from _common import DATA, parser
from oakland_cross_validation import files_of, read_blocks, trees_trial

from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.stage_parameters import GroundParameters
from mlsroad_pipeline.algorithms.geometry.assignment import assign_one_to_one
from mlsroad_pipeline.algorithms.inventory.objects.candidate_table import FEATURE_COLUMNS
from mlsroad_pipeline.algorithms.inventory.objects.class_groups import ClassEvidence, group_shares
from mlsroad_pipeline.algorithms.inventory.objects.object_classifier import ObjectClassifier
from mlsroad_pipeline.algorithms.inventory.training.candidates import find_candidate_rows
from mlsroad_pipeline.algorithms.inventory.training.classifiers import fit
from mlsroad_pipeline.algorithms.inventory.training.streets import Street
from mlsroad_pipeline.algorithms.models.boosted_trees.labeller import (
    describe_scene,
    parameters_of,
    voxel_probabilities,
)
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle, bundle_scheme
from mlsroad_pipeline.algorithms.stages import find_ground
from mlsroad_pipeline.model_store.object_classifiers import shipped_classifier
from mlsroad_pipeline.model_store.shipped_models import load_shipped

REACH = {"pole": 0.5, "sign": 0.5, "vehicle": 2.0}
LEAST_SCORE = 0.4
COLUMNS = list(FEATURE_COLUMNS)
SCHEME = bundle_scheme(load_shipped("pool"))


def street_of(name: str, cloud: PointCloud, bundle: ModelBundle) -> Street:
    """Return a block with the class probabilities of a model."""
    ground = find_ground(cloud, GroundParameters(**bundle.metadata["parameters"]["ground"]))
    voxels = describe_scene(cloud.with_columns(**ground), ground, voxel_size=parameters_of(bundle).voxel_size)
    known, n = np.isfinite(ground["height"]), len(cloud)
    owner = np.where(known, voxels.owner.astype(np.int64), -1)
    evidence = ClassEvidence(
        voxel_probabilities(voxels, bundle).astype(np.float32), owner, group_shares(SCHEME)
    )  # fmt: skip
    none = np.zeros(n, np.int32)
    height = np.where(known, ground["height"], 0.0).astype(np.float64)
    return Street(
        name, cloud.xyz.astype(np.float64), cloud.origin, height, evidence, none, none, pd.DataFrame(), SCHEME
    )


def with_truth(candidates: pd.DataFrame, truth: pd.DataFrame) -> pd.DataFrame:
    """Add whether each candidate is an object of its kind, one to one."""
    true = np.zeros(len(candidates), bool)
    for kind, reach in REACH.items():
        rows = np.flatnonzero(candidates["kind"] == kind)
        where = candidates[["x", "y"]].to_numpy()[rows]
        true[rows[assign_one_to_one(where, truth.loc[truth["kind"] == kind, ["x", "y"]].to_numpy(), reach)[0]]] = True
    return candidates.assign(true=true)


def shipped_scores(candidates: pd.DataFrame, classifier: ObjectClassifier) -> np.ndarray:
    """Return the scores of the shipped classifier."""
    scores = np.zeros(len(candidates))
    for kind in candidates["kind"].unique():
        mine = (candidates["kind"] == kind).to_numpy()
        scores[mine] = classifier.probabilities(kind, candidates.loc[mine, COLUMNS].to_numpy(np.float32))[:, 0]
    return scores


def learned_scores(
    candidates: pd.DataFrame, simulated: pd.DataFrame, classifier: ObjectClassifier, weight: float
) -> np.ndarray:  # fmt: skip
    """Return the scores of classifiers that learn from simulated streets and from the other blocks."""
    scores = shipped_scores(candidates, classifier)
    for kind in REACH:
        a, b = classifier.calibration[kind]
        own = simulated[(simulated["kind"] == kind) & ~simulated["ignored"].astype(bool)]
        for block in candidates["street"].unique():
            mine = (candidates["kind"] == kind) & (candidates["street"] == block)
            others = candidates[(candidates["kind"] == kind) & (candidates["street"] != block)]
            rows = pd.concat([own[[*COLUMNS, "true"]], others[[*COLUMNS, "true"]]], ignore_index=True)
            weights = np.r_[np.ones(len(own)), np.full(len(others), weight)]
            trees = fit(rows[COLUMNS], rows["true"].to_numpy(float), kind, weight=weights)
            if mine.any():
                raw = trees.scores(candidates.loc[mine, COLUMNS].to_numpy(np.float32))[:, 0]
                scores[mine.to_numpy()] = 1.0 / (1.0 + np.exp(-(a * raw + b)))
    return scores


def report(name: str, candidates: pd.DataFrame, scores: np.ndarray, truth: pd.DataFrame) -> None:
    """Print a row per kind: true, listed and found objects, precision, recall, F."""
    rated = candidates.assign(score=scores).sort_values("score", ascending=False)
    best = rated.drop_duplicates(["street", "own_kind", "part"])
    for kind, reach in REACH.items():
        listed = best[(best["kind"] == kind) & (best["score"] >= LEAST_SCORE)]
        true = truth.loc[truth["kind"] == kind, ["x", "y"]].to_numpy()
        found = len(assign_one_to_one(listed[["x", "y"]].to_numpy(), true, reach)[0])
        p, r = found / max(len(listed), 1), found / len(true)
        f = 2 * found / (len(listed) + len(true))
        print(f"| {name} | {kind} | {len(true)} | {len(listed)} | {found} | {p:.2f} | {r:.2f} | {f:.2f} |", flush=True)


def main() -> None:
    """Label, find candidates, score, print."""
    arguments = parser(__doc__)
    arguments.add_argument("folder", nargs="?", type=Path, default=DATA / "oakland")
    arguments.add_argument("--candidates", type=Path)
    arguments.add_argument("--weight", type=float, default=10.0)
    options = arguments.parse_args()
    clouds = read_blocks(files_of(options.folder))
    truth, classifier, trial = (
        pd.read_csv(options.folder / "objects.csv"),
        shipped_classifier(),
        trees_trial(clouds, SCHEME),
    )
    found = []
    for name, cloud in clouds.items():
        bundle = trial.train([rows for other, rows in trial.samples.items() if other != name], 2026)
        found.append(find_candidate_rows(street_of(name, cloud, bundle), classifier))
    candidates = with_truth(pd.concat(found, ignore_index=True), truth)
    print("| classifier | kind | true | listed | found | precision | recall | F |\n|---|---|---|---|---|---|---|---|")
    report("shipped", candidates, shipped_scores(candidates, classifier), truth)
    if options.candidates is not None:
        tables = [pd.read_parquet(path) for path in sorted(options.candidates.glob("*/candidates.parquet"))]
        simulated = pd.concat([table for table in tables if len(table)], ignore_index=True)
        for weight in (0.0, options.weight):
            scores = learned_scores(candidates, simulated, classifier, weight)
            report(f"simulated, other blocks with weight {weight:g}", candidates, scores, truth)


if __name__ == "__main__":
    main()

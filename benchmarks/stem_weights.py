"""Fit the weights that separate poles in crowns from trunks, on the training streets of the study of Yu et al. 2016.

    kedro run --pipelines=yu2016_study --to-nodes=make_yu2016_streets
    python benchmarks/stem_weights.py [--jobs 2] [--folds 8]

Every stem in a crown that belongs to a pole, a sign, a mast or a trunk is measured. The predictors of a logistic
regression are these measures and whether the stem is the least pole-like one nearby. The latter depends on the weights,
so the fit is iterated. The output is the number of misclassified stems of held-out streets by probability threshold,
that of `classify_stems` with its current parameters, and the weights fitted to all streets: `pole_weights`,
`trunk_weight` and `pole_intercept` of `PoleRefinementParameters`.
"""

from __future__ import annotations

import argparse

import joblib
import numpy as np
import pandas as pd
from cut_intensity import stored
from mlsroad_pipeline.algorithms.segmentation._nodes import measure_voxels, number_voxels
from mlsroad_pipeline.algorithms.segmentation.cut_parameters import NormalizedCutParameters
from mlsroad_pipeline.algorithms.segmentation.trunks import classify_stems, find_least_pole_like, measure_crowned
from numpy.typing import NDArray
from scipy.special import expit
from sklearn.linear_model import LogisticRegression
from sklearn.model_selection import GroupKFold

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY
from mlsroad_pipeline.algorithms.geometry.voxels.grid import build_voxel_grid
from mlsroad_pipeline.algorithms.segmentation.normalized_cut import cluster_points
from mlsroad_pipeline.algorithms.segmentation.stems import Stem, find_stems, whole_stems
from mlsroad_pipeline.algorithms.stages import inliers
from mlsroad_pipeline.execution.collection import SceneCollection
from mlsroad_pipeline.papers.yu2016.study.keys import street_key

MEASURES = ["bend", "lean", "spread", "aside", "reached", "under"]
POLES = [TAXONOMY[name] for name in ("utility_pole", "light_pole", "traffic_sign", "traffic_light", "post", "gantry",
                                     "station_sign", "wire")]  # fmt: skip
TRUNKS = [TAXONOMY[name] for name in ("trunk", "tree", "palm")]
CORE = 0.15  # distance from a stem's axis of the points whose majority class is that of the stem, metres
ROUNDS, PENALTY = 4, 3.0
_LABELS = max(TAXONOMY.values()) + 1


def stems_of(key: str, streets: SceneCollection, parameters: NormalizedCutParameters) -> pd.DataFrame:
    """Return one row per stem in a crown of a street: measures, true class and current classification as a pole."""
    scene = streets.part("points")[key].load()
    rows = np.flatnonzero(inliers(scene) & ~scene["ground"])
    xyz = np.ascontiguousarray(scene.xyz[rows], dtype=np.float64)
    clusters = cluster_points(xyz, parameters)
    grid = build_voxel_grid(xyz, voxel_size=parameters.voxel_size)
    voxel = number_voxels(clusters, grid.voxel_of_point)
    places, of_voxel = measure_voxels(xyz - grid.origin, np.zeros(len(xyz)), voxel, clusters)
    counts = np.bincount(voxel)
    labels = _most(voxel, scene["label"][rows])
    table = []
    for number, lines in find_stems(places[:, :3], of_voxel, parameters.pole_length).items():
        members = np.flatnonzero(of_voxel == number)
        own = np.ascontiguousarray(places[members, :3])
        stems = whole_stems(lines, own, counts[members])
        if not stems:
            continue
        _, crowned, measures = measure_crowned(own, counts[members], stems)
        poles = {id(stem) for stem in classify_stems(own, counts[members], stems)[0]}
        for k, values in zip(crowned, measures, strict=True):
            label = _label(stems[k], own, counts[members], labels[members])
            table.append([key, number, stems[k], label, id(stems[k]) in poles, *values])
    return pd.DataFrame(table, columns=["street", "cluster", "stem", "label", "now", *MEASURES])


def _most(voxel: NDArray[np.integer], labels: NDArray[np.integer]) -> NDArray[np.int64]:
    """Return the majority class of each voxel's points."""
    pairs, size = np.unique(voxel.astype(np.int64) * _LABELS + labels, return_counts=True)
    pairs = pairs[np.lexsort([size, pairs // _LABELS])]
    return pairs[np.append(np.flatnonzero(np.diff(pairs // _LABELS)), len(pairs) - 1)] % _LABELS


def _label(stem: Stem, xyz: NDArray[np.float64], counts: NDArray[np.int64], labels: NDArray) -> int:
    """Return the majority class of the points along a stem; 0 where there are none."""
    along = (stem.distance(xyz) <= CORE) & (xyz[:, 2] >= stem.low) & (xyz[:, 2] <= stem.high)
    return int(np.bincount(labels[along], counts[along], minlength=1).argmax())


def first_of(table: pd.DataFrame, scores: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return which stems are the least pole-like ones nearby, cluster by cluster."""
    first = np.zeros(len(table))
    for rows in table.groupby(["street", "cluster"]).indices.values():
        first[rows] = find_least_pole_like([table["stem"].iloc[row] for row in rows], scores[rows])
    return first


def fit(table: pd.DataFrame) -> tuple[NDArray[np.float64], float, float]:
    """Return the weights of the measures, the weight of the least pole-like stem, and the intercept."""
    known = table["label"].isin([*POLES, *TRUNKS]).to_numpy()
    values, truth = table[MEASURES].to_numpy(), table["label"].isin(POLES).to_numpy()
    scale = values[known].std(axis=0)
    first, model = np.zeros(len(table)), LogisticRegression(C=PENALTY, max_iter=3000)
    for _ in range(ROUNDS + 1):
        middle = values[known].mean(axis=0)
        model.fit(np.column_stack([(values - middle) / scale, first])[known], truth[known])
        weights = model.coef_[0, :-1] / scale
        offset = float(model.intercept_[0] - middle @ weights)
        first = first_of(table, values @ weights)
    return weights, float(model.coef_[0, -1]), offset


def held_out(table: pd.DataFrame, n_folds: int) -> NDArray[np.float64]:
    """Return the probability that each stem is a pole, with weights fitted to other streets."""
    chance = np.zeros(len(table))
    for rest, fold in GroupKFold(n_folds).split(table, groups=table["street"]):
        weights, first, offset = fit(table.iloc[rest])
        scores = table[MEASURES].to_numpy()[fold] @ weights
        chance[fold] = expit(offset + scores + first * first_of(table.iloc[fold], scores))
    return chance


def main() -> None:
    """Run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--folds", type=int, default=8)
    args = parser.parse_args()
    plan, streets = stored("streets")
    keys = [street_key(name, seed) for name, given in plan.scale.surveys.items() for seed in given.train]
    cuts = plan.stages.segmentation.normalized_cut
    tables = joblib.Parallel(n_jobs=args.jobs)(joblib.delayed(stems_of)(key, streets, cuts) for key in keys)
    table = pd.concat(tables, ignore_index=True)
    chance, label = held_out(table, args.folds), table["label"]
    pole, trunk = label.isin(POLES), label.isin(TRUNKS)
    judged = {"now": table["now"]} | {f"{level:.1f}": chance >= level for level in (0.2, 0.3, 0.4, 0.5)}
    rows = [
        (name, (pole & ~taken).sum(), (label.eq(TAXONOMY["light_pole"]) & ~taken).sum(),
         (label.eq(TAXONOMY["traffic_sign"]) & ~taken).sum(), (trunk & taken).sum())
        for name, taken in judged.items()
    ]  # fmt: skip
    print(f"{pole.sum()} poles and {trunk.sum()} trunks in crowns on {len(keys)} streets; misclassified:")
    names = ["threshold", "missed poles", "missed lamps", "missed signs", "trunks as poles"]
    print(pd.DataFrame(rows, columns=names).to_string(index=False))
    weights, first, offset = fit(table)
    print("weights", dict(zip(MEASURES, weights.round(2).tolist(), strict=True)), f"first {first:.2f}")
    print(f"offset {offset:.2f}")


if __name__ == "__main__":
    main()

"""Train the judge of the inventory's objects on simulated streets labelled by the shipped model `general`.

    python benchmarks/object_judges.py [--folder data/07_model_output/object_judges] [--write]

Simulates the streets of `SURVEYS`, none of which `general` was trained on, labels them with `general`, and makes the
candidates of `algorithms/inventory` on each. Boosted trees classify whether an upright line is a trunk or a pole, and
whether a candidate is an object of its kind. A candidate is true if it lies within the reach of a true object (0.5 m
for poles and signs, 1 m for vehicles and trees), one to one. Every fourth street is used a second time as a method
would label it that gives a class and a confidence, but no probabilities. Scores are calibrated on folds of streets that
the trees were not trained on. Prints precision, recall and calibration of these folds; with `--write` replaces the
judge of the package and its card. Streets and tables are kept in the folder: a second run continues where the first one
stopped.
"""

from __future__ import annotations

import argparse
import hashlib
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import lightgbm
import numpy as np
import pandas as pd

from mlsroad_pipeline.algorithms.baselines.boosted_trees.labeller import (
    describe_scene,
    parameters_of,
    voxel_probabilities,
)
from mlsroad_pipeline.algorithms.core.classes import TAXONOMY, TAXONOMY_NAMES
from mlsroad_pipeline.algorithms.inventory.candidates import CANDIDATE_LIMITS, classify_stems, raised_labels
from mlsroad_pipeline.algorithms.inventory.class_groups import ClassEvidence, evidence_of_labels, group_shares
from mlsroad_pipeline.algorithms.inventory.evidence import SceneCells
from mlsroad_pipeline.algorithms.inventory.judging import NEITHER, POLE, STEM, TRUNK
from mlsroad_pipeline.algorithms.inventory.measured_rows import Evidence, find_candidates
from mlsroad_pipeline.algorithms.inventory.object_features import FEATURES
from mlsroad_pipeline.algorithms.inventory.rules import KIND_OF_CLASS, KINDS, rules_for_scheme
from mlsroad_pipeline.algorithms.inventory.stem_features import STEM_FEATURES, find_scene_stems
from mlsroad_pipeline.algorithms.inventory.voxels import find_fragments, join_voxels
from mlsroad_pipeline.algorithms.metrics.object_matching import REACH, assign_one_to_one
from mlsroad_pipeline.algorithms.models.boosted_trees import BoostedTrees
from mlsroad_pipeline.algorithms.models.bundle import bundle_scheme
from mlsroad_pipeline.algorithms.models.object_judge import ObjectJudge
from mlsroad_pipeline.algorithms.stages import GroundParameters, find_ground
from mlsroad_pipeline.datasets.models.bundle_files import load_bundle
from mlsroad_pipeline.datasets.models.object_judges import CARD, FOLDER, JUDGE
from mlsroad_pipeline.datasets.models.shipped_models import FOLDER as MODELS
from mlsroad_pipeline.simulation import simulate_survey
from mlsroad_pipeline.simulation.parameters.presets import simulation_parameters
from mlsroad_pipeline.simulation.parameters.variety import expanded_surveys

STREETS = [
    "residential", "old_town", "american_suburb", "downtown", "town", "suburb", "industrial", "rural",
    "asian_arterial", "campus", "ring_road",
]  # fmt: skip
SURVEYS: dict[str, dict[str, Any]] = {
    "tr": {"count": 66, "seed": 9001, "length": 70.0, "variety": 0.5,
           "presets": ["demo", "small", "oakland", "hdl32", "sick_side", "mx9", "hdl64", "pandaset"]},
    "tq": {"count": 88, "seed": 9101, "length": 80.0, "variety": 0.3,
           "presets": ["small", "demo", "sick_side", "oakland"]},
    "tm": {"count": 11, "seed": 9201, "length": 25.0, "variety": 0.3, "presets": ["mx9"]},
}  # fmt: skip
MOST_POINTS = 2_500_000
LEAST_POINTS = {"pole": 20, "sign": 10, "vehicle": 50, "tree": 100}
FOLDS = 5
TREES = {
    "num_leaves": 8, "learning_rate": 0.06, "min_child_samples": 15, "feature_fraction": 0.4, "bagging_fraction": 0.8,
    "bagging_freq": 1, "lambda_l2": 10.0, "extra_trees": True, "max_bin": 127, "verbose": -1, "num_threads": 1,
    "seed": 1, "deterministic": True, "force_row_wise": True,
}  # fmt: skip
ROUNDS = {STEM: 120, "pole": 200, "sign": 200, "vehicle": 200, "tree": 200}
BUNDLE = load_bundle(MODELS / "general")
SCHEME = bundle_scheme(BUNDLE)
RULES = rules_for_scheme(SCHEME, changes=CANDIDATE_LIMITS)
TRUE_KINDS = {name: kind for name, kind in KIND_OF_CLASS.items() if name != "cycas"}  # low vegetation of the scheme
POLES = [TAXONOMY[name] for name, kind in KIND_OF_CLASS.items() if kind in ("pole", "sign")]
TRUNKS = [TAXONOMY[name] for name in ("trunk", "tree", "palm")]


class Street(NamedTuple):
    """A labelled street: points, heights, class probabilities, true class and object per point, true objects."""

    name: str
    local: np.ndarray
    origin: np.ndarray
    height: np.ndarray
    evidence: ClassEvidence
    truth: np.ndarray
    instance: np.ndarray
    objects: pd.DataFrame


def make_street(name: str, config: dict[str, Any], folder: Path) -> None:
    """Simulate and label a street and store it; streets of too many points are stored empty."""
    survey = simulate_survey(simulation_parameters(config), n_threads=1)
    cloud, path = survey.cloud, folder / f"{name}.npz"
    if len(cloud) > MOST_POINTS:
        np.savez(path, xyz=np.zeros((0, 3), np.float32))
        return
    ground = find_ground(cloud, GroundParameters(**BUNDLE.metadata["parameters"]["ground"]))
    voxels = describe_scene(cloud.with_columns(**ground), ground, voxel_size=parameters_of(BUNDLE).voxel_size)
    survey.objects.to_pickle(folder / f"{name}.pkl")
    np.savez(
        path, xyz=cloud.xyz.astype(np.float32), origin=survey.origin, height=ground["height"],
        owner=voxels.owner.astype(np.int32), prob=voxel_probabilities(voxels, BUNDLE).astype(np.float16),
        truth=cloud["label"].astype(np.uint8), instance=cloud["instance"].astype(np.int32),
    )  # fmt: skip


def read_street(name: str, folder: Path, *, hard: bool = False) -> Street | None:
    """Return a stored street; `hard`: with classes and confidences alone."""
    with np.load(folder / f"{name}.npz") as stored:
        arrays = dict(stored)
    if not 0 < len(arrays["xyz"]) <= MOST_POINTS:
        return None
    probabilities, owner = arrays["prob"].astype(np.float32), arrays["owner"].astype(np.int64)
    if hard:
        evidence = evidence_of_labels(probabilities.argmax(axis=1)[owner], probabilities.max(axis=1)[owner], SCHEME)
    else:
        evidence = ClassEvidence(probabilities, owner, group_shares(SCHEME))
    known = np.isfinite(arrays["height"])
    evidence = ClassEvidence(evidence.probabilities, np.where(known, evidence.owner, -1), evidence.groups)
    return Street(
        name, arrays["xyz"].astype(np.float64), arrays["origin"].astype(np.float64),
        np.where(known, arrays["height"], 0.0).astype(np.float64), evidence, arrays["truth"], arrays["instance"],
        pd.read_pickle(folder / f"{name}.pkl"),
    )  # fmt: skip


def cells_of(street: Street) -> SceneCells:
    """Return the cells of a street, which is one scene."""
    core = np.ones(len(street.local), bool)
    return SceneCells(street.local, core=core, origin=street.origin, evidence=street.evidence)


def stem_table(street: Street) -> pd.DataFrame:
    """Return the features of the stems of a street, and what each is."""
    labels = raised_labels(street.evidence, RULES)
    used = [label for rule in RULES.values() if rule.kind != "vehicle" for label in rule.labels]
    points = np.flatnonzero(np.isin(labels, used))
    stems = find_scene_stems(street.local, street.height, points, cells_of(street))
    table = pd.DataFrame(stems.features, columns=list(STEM_FEATURES))
    inside = stems.owner >= 0
    true, n = street.truth[points[inside]], len(table)
    size = np.maximum(np.bincount(stems.owner[inside], minlength=n), 1)
    trunk = np.bincount(stems.owner[inside], weights=np.isin(true, TRUNKS), minlength=n) / size
    pole = np.bincount(stems.owner[inside], weights=np.isin(true, POLES), minlength=n) / size
    return table.assign(target=np.where(trunk > 0.5, TRUNK, np.where(pole > 0.4, POLE, NEITHER)), street=street.name)


def true_objects(street: Street) -> pd.DataFrame:
    """Return the true objects of the kinds with their places, and whether they count: not moving, enough points."""
    table = street.objects
    counts = np.bincount(np.maximum(street.instance, 0), minlength=int(table["instance"].max()) + 1)
    kind = table["label"].map(lambda code: TRUE_KINDS.get(TAXONOMY_NAMES[code]))
    vehicle, panel = (kind == "vehicle").to_numpy(), ((kind == "sign") & table["panel_x"].notna()).to_numpy()
    x = np.where(vehicle, table["box_x"], np.where(panel, table["panel_x"], table["x"]))
    y = np.where(vehicle, table["box_y"], np.where(panel, table["panel_y"], table["y"]))
    n_points = counts[table["instance"].to_numpy()]
    enough = n_points >= kind.map(LEAST_POINTS).fillna(np.inf).to_numpy()
    counted = enough & ~table["moving"].to_numpy(bool)
    return pd.DataFrame({
        "kind": kind, "x": x, "y": y, "counted": counted, "instance": table["instance"], "length": table["length"],
    })[kind.notna().to_numpy()].reset_index(drop=True)  # fmt: skip


def candidate_table(street: Street, judge: ObjectJudge) -> pd.DataFrame:
    """Return the candidates of a street with their features and truth, as `extract_objects` makes them."""
    cells = cells_of(street)
    labels = raised_labels(street.evidence, RULES)
    labels = classify_stems(street.local, street.height, labels, cells, rules=RULES, judge=judge)
    rows, features = [], []
    for name, rule in RULES.items():
        mine = np.flatnonzero(np.isin(labels, rule.labels))
        whole, _, of_whole, _ = find_fragments(
            street.local[mine], core=np.ones(len(mine), bool), confidence=np.ones(len(mine)),
            height_above_ground=street.height[mine], origin=street.origin, rule=rule,
        )  # fmt: skip
        if not len(whole):
            continue
        kept = np.flatnonzero(of_whole >= 0)
        table = cells.around(mine[kept], whole["fragment"].to_numpy()[of_whole[kept]])
        voxels, number, joined = join_voxels(
            whole.assign(object=whole["fragment"], scene=0), resolution=rule.resolution
        )
        voxel = joined[of_whole[kept]]
        evidence = Evidence(table.assign(object=table["fragment"]))
        part = np.full(len(number), -1)
        first = len(rows)
        for candidate in find_candidates(voxels, number, name, RULES, [street.name], evidence):
            part[candidate.voxels] = candidate.part
            row = {key: candidate.row[key] for key in ("kind", "x", "y", "height", "point_count")}
            rows.append({**row, "part": candidate.part, "own_kind": rule.kind})
            features.append(candidate.features)
        instance = _most_frequent(part[voxel], street.instance[mine[kept]])
        for row in rows[first:]:
            row["instance"], row["shared"] = instance.get(row["part"], (0, 0))
    table = pd.DataFrame(rows).join(pd.DataFrame(np.array(features), columns=list(FEATURES)).add_prefix("f: "))
    return _with_truth(table.assign(street=street.name), true_objects(street), street)


def _most_frequent(part: np.ndarray, instance: np.ndarray) -> dict[int, tuple[int, int]]:
    """Return the object that most points of each part belong to, and their number."""
    counts = pd.DataFrame({"part": part, "instance": np.maximum(instance, 0)}).value_counts(sort=True).reset_index()
    best = counts.drop_duplicates("part")
    return {int(p): (int(i), int(n)) for p, i, n in best.itertuples(index=False)}


def _with_truth(table: pd.DataFrame, truth: pd.DataFrame, street: Street) -> pd.DataFrame:
    """Add `true` and `ignored`: first candidates of their own class are matched, then alternatives.

    A vehicle that is seen in part has its middle elsewhere, see `seen_in_part`.
    Candidates beside a true object that does not count are ignored.
    """
    true, ignored = np.zeros(len(table), bool), np.zeros(len(table), bool)
    where = table[["x", "y"]].to_numpy()
    for kind in KINDS:
        own = truth[(truth["kind"] == kind) & truth["counted"]]
        left = np.ones(len(own), bool)
        for same in (True, False):
            rows = np.flatnonzero((table["kind"] == kind) & ((table["own_kind"] == kind) == same) & ~true)
            free = np.flatnonzero(left)
            a, b = assign_one_to_one(where[rows], own[["x", "y"]].to_numpy()[free], REACH[kind])
            left[free[b]] = False
            true[rows[a]] = True
        rest = truth[(truth["kind"] == kind) & ~truth["counted"]]
        rows = np.flatnonzero((table["kind"] == kind).to_numpy() & ~true)
        gap = np.hypot(*(where[rows, None] - rest[["x", "y"]].to_numpy()).transpose(2, 0, 1))
        reach = REACH[kind] + (rest["length"].to_numpy() / 2 if kind == "vehicle" else 0.0)
        ignored[rows[(gap <= reach).any(axis=1)]] = True
    return table.assign(true=true | seen_in_part(table, truth), ignored=ignored & ~true)


def seen_in_part(table: pd.DataFrame, truth: pd.DataFrame) -> np.ndarray:
    """Return which candidates are the largest piece of a counted vehicle, to which half of their points belong."""
    counted = truth.loc[truth["counted"] & (truth["kind"] == "vehicle"), "instance"]
    vehicle = (table["kind"] == "vehicle") & table["instance"].isin(counted)
    vehicle &= table["shared"] >= 0.5 * table["point_count"]
    largest = table["shared"].where(vehicle, -1).groupby(table["instance"]).transform("max")
    return (vehicle & (table["shared"] == largest)).to_numpy()


def fit(table: pd.DataFrame, target: np.ndarray, classifier: str, seed: int = 1) -> BoostedTrees:
    """Train the trees of a classifier."""
    several = classifier == STEM
    parameters = {
        **TREES,
        "seed": seed,
        **({"objective": "multiclass", "num_class": 3} if several else {"objective": "binary"}),
    }
    # The scores begin at 0, which keeps the trees independent of the library's own start.
    data = lightgbm.Dataset(table.to_numpy(np.float32), target, params={"max_bin": TREES["max_bin"]})
    booster = lightgbm.train({**parameters, "boost_from_average": False}, data, ROUNDS[classifier])
    return BoostedTrees.from_lightgbm(booster.model_to_string())


def folds_of(streets: pd.Series) -> np.ndarray:
    """Return the fold of each row: whole streets."""
    number = {street: i % FOLDS for i, street in enumerate(sorted(streets.unique()))}
    return streets.map(number).to_numpy()


def held_out_scores(table: pd.DataFrame, target: np.ndarray, streets: pd.Series, classifier: str) -> np.ndarray:
    """Return the scores of each row by trees that were trained on other streets."""
    fold = folds_of(streets)
    out = np.zeros((len(table), 3 if classifier == STEM else 1))
    for k in range(FOLDS):
        out[fold == k] = fit(table[fold != k], target[fold != k], classifier).scores(
            table[fold == k].to_numpy(np.float32)
        )
    return out


def calibrated(scores: np.ndarray, target: np.ndarray) -> tuple[float, float]:
    """Return factor and summand of logistic calibration, by Newton's method."""
    a, b = 1.0, 0.0
    for _ in range(50):
        p = 1.0 / (1.0 + np.exp(-(a * scores + b)))
        w = np.maximum(p * (1.0 - p), 1e-9)
        gradient = np.array([(scores * (p - target)).sum() + 1e-3 * (a - 1.0), (p - target).sum()])
        hessian = np.array([[(w * scores**2).sum() + 1e-3, (w * scores).sum()], [(w * scores).sum(), w.sum()]])
        a, b = np.array([a, b]) - np.linalg.solve(hessian, gradient)
    return float(a), float(b)


def medians(values: np.ndarray) -> np.ndarray:
    """Return the medians of columns, NaN where a column has no value."""
    known = ~np.isnan(values).all(axis=0)
    out = np.full(values.shape[1], np.nan, np.float32)
    out[known] = np.nanmedian(values[:, known], axis=0)
    return out


def stem_judge(stems: pd.DataFrame) -> ObjectJudge:
    """Train the judge of stems, and print its scores on folds that it was not trained on."""
    table, target = stems[list(STEM_FEATURES)], stems["target"].to_numpy()
    scores = held_out_scores(table, target, stems["street"], STEM)
    powers = np.exp(scores - scores.max(axis=1, keepdims=True))
    p = powers / powers.sum(axis=1, keepdims=True)
    for name, column, least in (("trunk", TRUNK, 0.5), ("pole", POLE, 0.6)):
        chosen, right = p[:, column] > least, target == column
        line = {
            "classifier": STEM,
            "class": name,
            "stems": len(target),
            "precision": right[chosen].mean(),
            "recall": chosen[right].mean(),
        }
        print(
            json.dumps({k: v if isinstance(v, str | int) else round(float(v), 3) for k, v in line.items()}), flush=True
        )
    typical = medians(table.to_numpy(np.float32))
    return ObjectJudge({STEM: STEM_FEATURES}, {STEM: fit(table, target, STEM)}, {STEM: (1.0, 0.0)}, {STEM: typical})


def kind_judge(
    candidates: pd.DataFrame, judge: ObjectJudge, n_true: dict[str, int]
) -> tuple[ObjectJudge, dict[str, dict[str, float]]]:
    """Add the judges of the kinds; return also the figures of held-out streets by kind."""
    parts = [dict(value) for value in (judge.features, judge.trees, judge.calibration, judge.typical)]
    held, figures = [], {}
    for kind in KINDS:
        rows = candidates[(candidates["kind"] == kind) & ~candidates["ignored"]]
        table = rows[[f"f: {name}" for name in FEATURES]]
        target = rows["true"].to_numpy(float)
        scores = held_out_scores(table, target, rows["street"], kind)[:, 0]
        a, b = calibrated(scores, target)
        false = table.to_numpy(np.float32)[target == 0]
        for part, value in zip(parts, (FEATURES, fit(table, target, kind), (a, b), medians(false)), strict=True):
            part[kind] = value
        held.append(
            rows[["street", "kind", "part", "own_kind", "true", "x", "y"]].assign(
                score=1 / (1 + np.exp(-(a * scores + b)))
            )
        )
        figures[kind] = held_out_figures(held[-1], n_true[kind])
        print(json.dumps({"classifier": kind, **figures[kind]}), flush=True)
    return ObjectJudge(*parts), figures


def held_out_figures(rows: pd.DataFrame, n_true: int) -> dict[str, float]:
    """Return precision, recall and F at the best threshold and at 0.5, and the expected calibration error."""
    p, y = rows["score"].to_numpy(), rows["true"].to_numpy(bool)

    def at(least: float) -> tuple[float, float, float]:
        n, right = int((p >= least).sum()), int(y[p >= least].sum())
        return right / max(n, 1), right / max(n_true, 1), 2 * right / max(n + n_true, 1)

    best = max(np.arange(0.05, 0.95, 0.05), key=lambda least: at(least)[2])
    bins = np.minimum((p * 10).astype(int), 9)
    error = sum(
        abs(p[bins == k].mean() - y[bins == k].mean()) * (bins == k).mean() for k in range(10) if (bins == k).any()
    )
    names = ("precision", "recall", "f")
    figures = {"candidates": len(p), "true_objects": n_true, "found": int(y.sum()), "best_threshold": best}
    figures |= dict(zip(names, at(best), strict=True)) | dict(zip([f"{n}_at_0.4" for n in names], at(0.4), strict=True))
    return {k: round(float(v), 3) for k, v in {**figures, "calibration_error": error}.items()}


def card(figures: dict[str, dict[str, float]], n_streets: int, n_simulated: int) -> str:
    """Return the card of the judge."""
    lines = [
        "# Judge of objects",
        "",
        "Boosted trees that give the objects of an inventory their scores, and tell trunks from poles. MIT licence.",
        f"Trained on {n_streets} simulated streets of {len(STREETS)} kinds (of {n_simulated}: those with at most",
        f"{MOST_POINTS:,} points), labelled by the shipped model `general`, which was not trained on them.",
        "No recording was used.",
        f"Seeds {', '.join(str(c['seed']) for c in SURVEYS.values())}; scanners",
        f"{', '.join(sorted({preset for c in SURVEYS.values() for preset in c['presets']}))}.",
        "",
        "Candidates of streets that the trees were not trained on (five folds of streets), a quarter of the streets",
        "also with labels and confidences in place of probabilities:",
        "",
        "| kind | true objects | candidates | precision at 0.4 | recall at 0.4 | F at 0.4 | calibration error |",
        "|---|---|---|---|---|---|---|",
    ]
    for kind, row in figures.items():
        shown = [f"{row['true_objects']:.0f}", f"{row['candidates']:.0f}"]
        names = ("precision_at_0.4", "recall_at_0.4", "f_at_0.4", "calibration_error")
        lines.append(f"| {kind} | {' | '.join([*shown, *(f'{row[name]:.2f}' for name in names)])} |")
    return "\n".join([*lines, "", "Made by `python benchmarks/object_judges.py --write`.", ""])


def tables(names: list[str], folder: Path, what: str, make: Any) -> Iterator[pd.DataFrame]:
    """Yield a table per street, and per fourth street a second one of labels alone; stored tables are read."""
    for i, name in enumerate(names):
        for hard in (False, True) if i % 4 == 0 else (False,):
            path = folder / f"{what}_{name}{'_labels' if hard else ''}.parquet"
            if not path.exists():
                street = read_street(name, folder, hard=hard)
                table = pd.DataFrame() if street is None else make(street)
                table.to_parquet(path)
            yield pd.read_parquet(path)


def main() -> None:
    """Simulate, train, print; write the judge if asked."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--folder", type=Path, default=Path("data/07_model_output/object_judges"))
    parser.add_argument("--write", action="store_true")
    options = parser.parse_args()
    folder = options.folder
    folder.mkdir(parents=True, exist_ok=True)
    surveys = {name: {**config, "streets": STREETS, "with_images": False} for name, config in SURVEYS.items()}
    configs = {name: dict(config) for name, config in expanded_surveys(surveys).items() if config is not None}
    for name, config in configs.items():
        if not (folder / f"{name}.npz").exists():
            make_street(name, config, folder)
    names = list(configs)
    judge = stem_judge(pd.concat(tables(names, folder, "stems", stem_table), ignore_index=True))
    version = hashlib.sha256(
        b"".join(np.ascontiguousarray(a).tobytes() for a in judge.trees[STEM].to_arrays().values())
    )
    what = f"candidates_{version.hexdigest()[:8]}"
    candidates = pd.concat(tables(names, folder, what, lambda s: candidate_table(s, judge)), ignore_index=True)
    n_true = dict.fromkeys(KINDS, 0)
    for i, name in enumerate(names):
        street = read_street(name, folder)
        if street is not None:
            truth = true_objects(street)
            for kind, n in truth.loc[truth["counted"], "kind"].value_counts().items():
                n_true[str(kind)] += int(n) * (2 if i % 4 == 0 else 1)
    judge, figures = kind_judge(candidates, judge, n_true)
    np.savez_compressed(folder / "judge.npz", **judge.to_arrays())
    if options.write:
        FOLDER.mkdir(exist_ok=True)
        (FOLDER / JUDGE).write_bytes((folder / "judge.npz").read_bytes())
        used = candidates["street"].nunique()
        (FOLDER / CARD).write_text(card(figures, used, len(names)), encoding="utf-8")
        print(f"written: {FOLDER / JUDGE}, {FOLDER / CARD}")


if __name__ == "__main__":
    main()

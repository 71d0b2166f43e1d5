"""Objects of Oakland 3-D after answers about objects: F of poles, signs and vehicles with a judge that has learned.

    python benchmarks/learning_objects.py [FOLDER]

FOLDER holds the blocks and objects.csv; by default it is $MLSROAD_DATA/oakland. Each block is labelled by the shipped
model `general`. A simulated user answers about objects that are listed in the ten other blocks, the least certain first
or in random order (five seeds), and the judge of `mlsroad learn` rates the candidates of the block. The labels stay as
they are, so that the effect of the judge alone is measured. `all` are all candidates of the other blocks.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd
from judge_candidates import find_candidate_rows
from oakland_cross_validation import CONF, ENVIRONMENT, SUFFIX, configured, read
from oakland_objects import COLUMNS, LEAST_SCORE, REACH, shipped_scores, street_of, with_truth

from mlsroad_pipeline.algorithms.core.codings import Coding
from mlsroad_pipeline.algorithms.geometry.assignment import assign_one_to_one
from mlsroad_pipeline.algorithms.inventory.objects.classifier_continuation import JudgedCandidates, continue_judge
from mlsroad_pipeline.model_store.object_judges import read_judge_replay, shipped_judge
from mlsroad_pipeline.model_store.shipped_models import load_shipped

SEEDS, ANSWERS = 5, (0, 10, 50, 200)
PART = ["street", "own_kind", "part"]


def listed(candidates: pd.DataFrame, scores: np.ndarray) -> pd.DataFrame:
    """Return the best candidate of each part whose score reaches the least one."""
    best = candidates.assign(score=scores).sort_values("score", ascending=False, kind="stable").drop_duplicates(PART)
    return best[best["score"] >= LEAST_SCORE]


def figures(candidates: pd.DataFrame, scores: np.ndarray, truth: pd.DataFrame) -> dict[str, float]:
    """Return F by kind."""
    best, found = listed(candidates, scores), {}
    for kind, reach in REACH.items():
        own, true = best.loc[best["kind"] == kind, ["x", "y"]], truth.loc[truth["kind"] == kind, ["x", "y"]]
        right = len(assign_one_to_one(own.to_numpy(), true.to_numpy(), reach)[0])
        found[kind] = 2 * right / (len(own) + len(true))
    return found


def order(best: pd.DataFrame, seed: int | None) -> np.ndarray:
    """Return the order in which the user answers: at random, or the least certain first."""
    if seed is not None:
        return np.random.default_rng(seed).permutation(len(best))
    return np.argsort(np.abs(best["score"].to_numpy() - 0.5), kind="stable")


def learned_scores(candidates: pd.DataFrame, base: np.ndarray, number: int | None, seed: int | None) -> np.ndarray:
    """Return the scores of each block by a judge that has learned from answers about the other blocks."""
    judge, replay, scores = shipped_judge(), read_judge_replay(), base.copy()
    for block in candidates["street"].unique():
        mine, others = candidates["street"] == block, candidates[candidates["street"] != block]
        if number is not None:
            best = listed(others, base[others.index])
            asked = best.iloc[order(best, seed)[:number]][PART]
            others = others.merge(asked, on=PART)
        answers = {kind: judged(own) for kind, own in others.groupby("kind") if kind in REACH}
        learned = continue_judge(judge, answers, replay)
        for kind in REACH:
            rows = np.flatnonzero(mine & (candidates["kind"] == kind))
            if len(rows):
                scores[rows] = learned.probabilities(kind, candidates[COLUMNS].to_numpy(np.float32)[rows])[:, 0]
    return scores


def judged(rows: pd.DataFrame) -> JudgedCandidates:
    """Return candidates with the truth."""
    return JudgedCandidates(rows[COLUMNS].to_numpy(np.float32), rows["true"].to_numpy(bool))


def trials() -> Iterator[tuple[str, int | None, list[int | None]]]:
    """Yield name, number of answers (None for all) and seeds (None: the least certain first) of each row."""
    for number in ANSWERS[1:]:
        yield f"{number}, least certain first", number, [None]
        yield f"{number}, random", number, list(range(SEEDS))
    yield "all", None, [None]


def main() -> None:
    """Label, find candidates, answer, learn, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    default = Path(os.environ.get("MLSROAD_DATA", CONF.parents[1] / "shared/data")) / "oakland"
    parser.add_argument("folder", nargs="?", type=Path, default=default)
    folder = parser.parse_args().folder
    coding = Coding("oakland", configured("classes", ENVIRONMENT)["codings"]["oakland"])
    files = sorted(folder.glob(f"*{SUFFIX}"))
    if len(files) < 2:
        parser.error(f"{folder} has {len(files)} files *{SUFFIX}: two are needed")
    truth, bundle = pd.read_csv(folder / "objects.csv"), load_shipped("general")
    found = [
        find_candidate_rows(street_of(path.name.removesuffix(SUFFIX), read(path, coding), bundle), shipped_judge())
        for path in files
    ]
    candidates = with_truth(pd.concat(found, ignore_index=True), truth)
    base = shipped_scores(candidates, shipped_judge())
    print("| answers | poles | signs | vehicles | mean |\n|---|---|---|---|---|")

    def show(name: str, rows: list[dict[str, float]]) -> None:
        means = [float(np.mean([row[kind] for row in rows])) for kind in REACH]
        print(f"| {name} | {' | '.join(f'{value:.2f}' for value in [*means, np.mean(means)])} |", flush=True)

    show("none", [figures(candidates, base, truth)])
    for name, number, seeds in trials():
        rows = [figures(candidates, learned_scores(candidates, base, number, seed), truth) for seed in seeds]
        show(name, rows)


if __name__ == "__main__":
    main()

"""Measure what the words add to sizes and profiles in `visual_words`, by class, on held-out training streets.

    kedro run --pipelines=yu2016_study --params=yu2016_study.scale=printed --to-nodes=describe_yu2016_objects
    python benchmarks/words_worth.py [--scale printed] [--vocabularies 2:50 0:50 4:50 2:20 2:200] [--divisions 20]

A vocabulary is written k:g, for k neighbours in a contextual group and one word per g groups. For each vocabulary and
each division of the similarity among bags of words, sizes and profiles, every training object is scored by the machines
that were trained without its street. Streets are divided into random halves. Shares (and the vocabulary) of each class
and its threshold are those with the highest F-score on one half, and are applied to the other half. `without` chooses
among shares without bags, `with` among all shares of the first vocabulary, `any vocabulary` among all of all. Intervals
are bootstrap intervals over streets of the difference from `without` (95 %).
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import joblib
import numpy as np
import pandas as pd
from cut_intensity import stored
from numpy.typing import NDArray

from mlsroad_pipeline.execution.collection import SceneCollection
from mlsroad_pipeline.papers.shared.detection.thresholds import best_threshold, detect_by_thresholds
from mlsroad_pipeline.papers.yu2016.study.keys import street_key
from mlsroad_pipeline.papers.yu2016.study.objects import DESCRIPTIONS, describe_street
from mlsroad_pipeline.papers.yu2016.study.parameters import CUT, WORDS
from mlsroad_pipeline.papers.yu2016.study.plan import StudyPlan
from mlsroad_pipeline.papers.yu2016.visual_words.detector import VisualWordsDetector
from mlsroad_pipeline.papers.yu2016.visual_words.queries import HeldOut
from mlsroad_pipeline.papers.yu2016.visual_words.training import make_words

SAMPLES = 2000


class Choice(NamedTuple):
    """Vocabulary, and shares of sizes and profiles in the similarity; the rest is the share of the bags."""

    vocabulary: str
    size: float
    profile: float

    @property
    def bags(self) -> float:
        """Return the share of the bags."""
        return 1.0 - self.size - self.profile


def grid(step: float) -> list[tuple[float, float]]:
    """Return all shares of sizes and profiles in multiples of a step."""
    n = round(1 / step)
    return [(i * step, j * step) for i in range(n + 1) for j in range(n + 1 - i)]


def score_vocabulary(
    name: str, plan: StudyPlan, keys: Sequence[str], stores: Sequence[SceneCollection], shares: Sequence[tuple]
) -> dict[Choice, HeldOut]:
    """Describe the streets for one vocabulary, and return the held-out scores for all shares."""
    streets, segmented, described = stores
    k, per_word = name.split(":")
    own = plan.methods[WORDS]
    words = replace(own, k=int(k), vocabulary=replace(own.vocabulary, groups_per_word=float(per_word)))
    if words.k == own.k:
        groups = [described.part("parts")[f"{WORDS}.{key}"].load() for key in keys]
    else:
        groups = [
            describe_street(
                streets.part("points")[key].load(),
                segmented.part("objects")[f"{CUT}.{key}"].load(),
                kind=DESCRIPTIONS[WORDS],
                parameters=words.groups,
            )["parts"]
            for key in keys
        ]  # fmt: skip
    labels = [segmented.part("classes")[f"{CUT}.{key}"].load() for key in keys]
    _, objects = make_words(groups, labels, intensity=True, parameters=words, detection=plan.detection)
    found = {}
    for size, profile in shares:
        detector = VisualWordsDetector(
            plan.detection.classes, parameters=replace(words.detector, size_share=size, profile_share=profile)
        )
        detector.fit(objects.counts, objects.labels, sizes=objects.sizes, profiles=objects.profiles,
                     scenes=objects.scenes)  # fmt: skip
        found[Choice(name, size, profile)] = detector.held_out_
    return found


class Divided(NamedTuple):
    """Counts of one selection: right, wanted and false objects by street and class, and what was chosen."""

    counts: NDArray[np.float64]
    chosen: list[Counter]


def select_and_count(
    found: dict[Choice, HeldOut], choices: Sequence[Choice], halves: Sequence[NDArray[np.bool_]], n_classes: int
) -> Divided:
    """Choose by class on one half of the streets, and count the detections on the other half."""
    first = found[choices[0]]
    counts = np.zeros((int(first.scenes.max()) + 1, n_classes, 3))
    chosen: list[Counter] = [Counter() for _ in range(n_classes)]
    for first_half in halves:
        for learned in (first_half[first.scenes], ~first_half[first.scenes]):
            scores, thresholds = np.zeros((len(learned), n_classes)), np.zeros(n_classes)
            for k in range(n_classes):
                truth = first.labels[learned] == k
                tried = [best_threshold(found[c].scores[learned, k], truth, np.ones(len(truth))) for c in choices]
                best = int(np.argmax([f for f, _ in tried]))
                chosen[k][choices[best]] += 1
                scores[:, k], thresholds[k] = found[choices[best]].scores[:, k], tried[best][1]
            labels = detect_by_thresholds(scores, thresholds)[0]
            for k in range(n_classes):
                right, wanted = (labels == k) & (first.labels == k), first.labels == k
                for column, rows in enumerate((right, wanted, (labels == k) & ~wanted)):
                    np.add.at(counts[:, k, column], first.scenes[rows & ~learned], 1.0)
    return Divided(counts / len(halves), chosen)


def f_score(counts: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the F-score of counts in the last axis."""
    right, wanted, false = np.moveaxis(counts, -1, 0)
    return 2 * right / np.maximum(wanted + right + false, 1e-9)


def interval(one: NDArray[np.float64], other: NDArray[np.float64], seed: int) -> tuple[float, float]:
    """Return the bootstrap interval over streets of the difference of two F-scores; counts are (streets, 3)."""
    drawn = np.random.default_rng(seed).integers(len(one), size=(SAMPLES, len(one)))
    low, high = np.quantile(f_score(one[drawn].sum(axis=1)) - f_score(other[drawn].sum(axis=1)), [0.025, 0.975])
    return float(low), float(high)


def tabulate(
    found: dict[Choice, HeldOut], plan: StudyPlan, halves: Sequence[NDArray[np.bool_]], seed: int
) -> pd.DataFrame:
    """Return the F-score of every selection, by class and of all classes."""
    first = next(iter(found)).vocabulary
    selections = {
        "without": [c for c in found if c.vocabulary == first and c.bags == 0],
        "with": [c for c in found if c.vocabulary == first],
        "any vocabulary": list(found),
        "as configured": [c for c in found if (c.vocabulary, c.size, c.profile) == (first, 0.25, 0.5)],
        **{f"bags alone, {c.vocabulary}": [c] for c in found if c.bags == 1},
    }
    classes = plan.detection.classes
    counted = {name: select_and_count(found, given, halves, len(classes)) for name, given in selections.items()}
    rows = []
    for k, label in enumerate((*classes, "all")):
        part = {
            name: each.counts[:, k] if label != "all" else each.counts.sum(axis=1) for name, each in counted.items()
        }
        for name, counts in part.items():
            low, high = interval(counts, part["without"], seed)
            value = float(f_score(counts.sum(axis=0)))
            gain = value - float(f_score(part["without"].sum(axis=0)))
            tallied = counted[name].chosen[k].most_common(1) if label != "all" else []
            most = "" if not tallied else "{} {:.2f} {:.2f}".format(*tallied[0][0])
            share = (
                np.nan
                if not tallied
                else np.average(
                    [c.bags for c in counted[name].chosen[k]], weights=list(counted[name].chosen[k].values())
                )
            )
            rows.append((label, name, counts[:, 1].sum(), value, gain, low, high, share, most))
    columns = ["class", "selection", "objects", "f_score", "gain", "low", "high", "share_of_bags", "chosen_most"]
    return pd.DataFrame(rows, columns=columns)


def main() -> None:
    """Run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scale", default="printed", help="scale of the study whose training streets are read")
    parser.add_argument("--vocabularies", nargs="+", default=["2:50", "0:50", "4:50", "2:20", "2:200"])
    parser.add_argument("--step", type=float, default=0.25, help="of the shares")
    parser.add_argument("--divisions", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=2)
    args = parser.parse_args()
    plan, *stores = stored("streets", "objects", "described", scale=args.scale)
    keys = [street_key(name, seed) for name, given in plan.scale.surveys.items() for seed in given.train]
    jobs = (joblib.delayed(score_vocabulary)(name, plan, keys, stores, grid(args.step)) for name in args.vocabularies)
    found: dict[Choice, HeldOut] = {}
    for part in joblib.Parallel(n_jobs=args.jobs)(jobs):
        found |= part
    rng = np.random.default_rng(args.seed)
    halves = [rng.permutation(len(keys)) % 2 == 0 for _ in range(args.divisions)]
    print(tabulate(found, plan, halves, args.seed).round(3).to_string(index=False))


if __name__ == "__main__":
    main()

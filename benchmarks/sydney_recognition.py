"""Recognisers on the Sydney Urban Objects: three-fold cross-validation over seeds, with times.

python benchmarks/sydney_recognition.py FOLDER --methods jointnet spin_image --seeds 1 2 3 --jobs 2
"""

from __future__ import annotations

import json
import time
from dataclasses import replace
from typing import Any

import numpy as np
from _common import configured, parser
from joblib import Parallel, delayed
from sklearn.metrics import f1_score

from mlsroad_pipeline.algorithms.core.classes import find_scheme
from mlsroad_pipeline.algorithms.models.methods import METHODS
from mlsroad_pipeline.papers.shared.recognition.object_set import ObjectSet, find_folds, listed_files, read_fold
from mlsroad_pipeline.papers.shared.recognition.recogniser import make_recogniser


def parameters_of(slug: str, seed: int, changes: dict[str, Any]) -> Any:
    def join(old: Any, new: Any) -> Any:
        return {**old, **{k: join(old[k], v) for k, v in new.items()}} if isinstance(old, dict) else new

    found = METHODS[slug].load("parameters")(**join(configured(METHODS[slug].group or slug), changes))
    return replace(found, training=replace(found.training, seed=seed)) if hasattr(found, "training") else replace(
        found, seed=seed
    )  # fmt: skip


def read_folds(folder: str) -> dict[str, ObjectSet]:
    scheme = find_scheme(configured("classes")["schemes"], "sydney14")
    return {
        name: ObjectSet.from_arrays(read_fold(str(path), [str(f) for f in listed_files(path)], scheme=scheme))
        for name, path in find_folds(folder, "folds/fold*.txt").items()
    }


def score(
    slug: str, seed: int, changes: dict[str, Any], train: ObjectSet, test: ObjectSet
) -> tuple[float, float, float]:
    start = time.process_time()
    found = make_recogniser(slug, parameters_of(slug, seed, changes))
    found.fit(train.objects, train.label, intensities=train.intensities)
    middle = time.process_time()
    scores = found.predict_proba(test.objects, intensities=test.intensities)
    predicted = found.classes_[scores.argmax(axis=1)]
    figure = f1_score(test.label, predicted, average="weighted", zero_division=0)
    return float(figure), middle - start, time.process_time() - middle


def main() -> None:
    arguments = parser(__doc__)
    arguments.add_argument("folder")
    arguments.add_argument("--methods", nargs="+", default=["jointnet"])
    arguments.add_argument("--seeds", nargs="+", type=int, default=[1, 2, 3])
    arguments.add_argument("--jobs", type=int, default=1)
    arguments.add_argument("--changes", type=json.loads, default={})
    options = arguments.parse_args()
    folds = read_folds(options.folder)
    runs = {b: (ObjectSet.join([s for a, s in folds.items() if a != b]), folds[b]) for b in folds}
    for slug in options.methods:
        start = time.perf_counter()
        plan = [(seed, name) for seed in options.seeds for name in runs]
        found = Parallel(n_jobs=options.jobs)(
            delayed(score)(slug, seed, options.changes, *runs[name]) for seed, name in plan
        )
        figures = np.array([f for f, _, _ in found]).reshape(len(options.seeds), len(runs))
        means = figures.mean(axis=1)
        recognised = len(options.seeds) * sum(len(test) for _, test in runs.values())
        line = {"method": slug, "changes": options.changes, "weighted_f1": round(float(means.mean()), 4)}
        line |= {"of_seeds": np.round(means, 4).tolist(), "wall_s": round(time.perf_counter() - start, 1)}
        line |= {"of_runs": dict(zip(runs, np.round(figures.mean(axis=0), 4).tolist(), strict=True))}
        line |= {"train_cpu_s_per_seed": round(sum(t for _, t, _ in found) / len(options.seeds), 1)}
        line |= {"recognise_ms_per_object": round(1000 * sum(t for _, _, t in found) / recognised, 3)}
        print(json.dumps(line), flush=True)


if __name__ == "__main__":
    main()

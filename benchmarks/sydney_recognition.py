"""Recognisers on the Sydney Urban Objects: three-fold cross-validation over seeds, with intervals and times.

    python benchmarks/sydney_recognition.py FOLDER --methods jointnet spin_image --seeds 1 2 3 --jobs 2
    python benchmarks/sydney_recognition.py FOLDER --methods $(python benchmarks/sydney_recognition.py --steps)

The steps lead from `jointnet_printed` to `jointnet_tuned`; each adds one change to those before. The interval is from
a bootstrap over the objects of each fold. Predictions are kept in the folder of results, and a run continues with them.
"""

from __future__ import annotations

import hashlib
import json
import time
from dataclasses import replace
from itertools import accumulate
from pathlib import Path
from typing import Any

import numpy as np
from _common import RESULTS, configured, parser
from joblib import Parallel, delayed
from numpy.typing import NDArray
from sklearn.metrics import f1_score

from mlsroad_pipeline.algorithms.core.classes import find_scheme
from mlsroad_pipeline.algorithms.models.methods import METHODS
from mlsroad_pipeline.papers.luo2019.jointnet.network import JointNet
from mlsroad_pipeline.papers.shared.recognition.object_set import ObjectSet, find_folds, listed_files, read_fold
from mlsroad_pipeline.papers.shared.recognition.recogniser import make_recogniser

N_SAMPLES = 2000
"""Samples of the bootstrap."""

PAPER_WIDTHS = {
    "convolutional_widths": [64, 128, 256, 256, 256], "n_hidden": 4096, "map_channels": 64,
    "fusion_widths": [64, 64], "cnn3_widths": [64, 64, 128, 128],
}  # fmt: skip
"""Widths whose weights take what Table 1 of the paper has, with momenta: Figure 8 is not readable in the text."""


def merged(old: Any, new: Any) -> Any:
    """Return nested parameters with changes; new names are added."""
    if not isinstance(old, dict) or not isinstance(new, dict):
        return new
    return {**old, **{key: merged(old.get(key, {}), value) for key, value in new.items()}}


PATH: dict[str, dict[str, Any]] = {
    "corrected_equations": {"inputs": {"printed_equations": False}},
    "headings": {"training": {"augmentation": {"rotate": True}, "n_turns": 8}},
    "shares": {"inputs": {"relative": True, "compress": True}},
    "metres": {"inputs": {"window": [2.0, 4.0], "bilinear": True}},
    "rate": {"network": {"initialisation": "he"}, "training": {"learning_rate": 0.01, "loss": "mean", "clip": 1.0}},
    "copies": {"training": {"copies": 4, "augmentation": {"drop": 0.6, "occlude": 0.4, "scale": 0.1}}},
}
STEPS = dict(zip(PATH, accumulate(PATH.values(), merged), strict=True))
STEPS |= {"he": {"network": {"initialisation": "he"}, "training": {"loss": "mean"}}}
STEPS |= {"paper_widths": merged(STEPS["corrected_equations"], {"network": PAPER_WIDTHS})}
STEPS |= {f"{view}_module": merged(STEPS["copies"], {"inputs": {"views": [view]}, "network": {"fusion": False}})
          for view in ("hssi", "vqai", "vaai")}  # fmt: skip
"""Changes of `jointnet_printed`, by the name of a step."""


def parameters_of(slug: str, seed: int, changes: dict[str, Any]) -> Any:
    """Return the parameters of a method or step."""
    if slug in STEPS:
        slug, changes = "jointnet_printed", merged(STEPS[slug], changes)
    found = METHODS[slug].load("parameters")(**merged(configured(METHODS[slug].group or slug), changes))
    return replace(found, training=replace(found.training, seed=seed)) if hasattr(found, "training") else replace(
        found, seed=seed
    )  # fmt: skip


def read_folds(folder: str) -> dict[str, ObjectSet]:
    """Return the objects of each fold."""
    scheme = find_scheme(configured("classes")["schemes"], "sydney14")
    return {
        name: ObjectSet.from_arrays(read_fold(str(path), [str(f) for f in listed_files(path)], scheme=scheme))
        for name, path in find_folds(folder, "folds/fold*.txt").items()
    }


def recognise(
    slug: str, seed: int, changes: dict[str, Any], train: ObjectSet, test: ObjectSet, kept: Path
) -> tuple[NDArray, float, float]:
    """Return the predicted classes, and the processor seconds of training and of recognition."""
    parameters = parameters_of(slug, seed, changes)
    key = hashlib.sha256(repr((parameters, len(train), len(test))).encode()).hexdigest()[:16]
    path = kept / f"{slug}_{seed}_{key}.npz"
    if path.is_file():
        with np.load(path) as stored:
            return stored["predicted"], float(stored["train"]), float(stored["test"])
    start = time.process_time()
    found = make_recogniser("jointnet_printed" if slug in STEPS else slug, parameters)
    found.fit(train.objects, train.label, intensities=train.intensities)
    middle = time.process_time()
    scores = found.predict_proba(test.objects, intensities=test.intensities)
    predicted, end = found.classes_[scores.argmax(axis=1)], time.process_time()
    kept.mkdir(parents=True, exist_ok=True)
    np.savez(path.with_suffix(".part.npz"), predicted=predicted, train=middle - start, test=end - middle)
    path.with_suffix(".part.npz").replace(path)
    return predicted, middle - start, end - middle


def weighted_f1(truth: NDArray, predicted: NDArray) -> float:
    """Return the F1 weighted by the number of objects."""
    return float(f1_score(truth, predicted, average="weighted", zero_division=0))


def interval(truths: list[NDArray], predictions: list[list[NDArray]]) -> list[float]:
    """Return the 95 % interval of the mean over folds and seeds, of a bootstrap over the objects of each fold."""
    rng, means = np.random.default_rng(0), []
    for _ in range(N_SAMPLES):
        rows = [rng.integers(len(truth), size=len(truth)) for truth in truths]
        means.append(
            np.mean(
                [
                    weighted_f1(truth[row], fold[row])
                    for seeds in predictions
                    for truth, fold, row in zip(truths, seeds, rows, strict=True)
                ]
            )
        )
    return np.round(np.quantile(means, [0.025, 0.975]), 3).tolist()


def print_sizes() -> None:
    """Print weights, and mebibytes with momenta, of networks of nine classes (Table 1 of the paper)."""
    sub_network = {"inputs": {"views": ["hssi"]}, "network": {"fusion": False}}
    for name, slug, changes in (
        ("JointNet", "paper_widths", {}),
        ("sub-network", "paper_widths", sub_network),
        ("jointnet_printed", "jointnet_printed", {}),
    ):
        network = JointNet(parameters_of(slug, 1, changes), 9)
        weights = sum(parameter.numel() for parameter in network.parameters())
        print(f"{name}: {weights:,} weights, {8 * weights / 2**20:.1f} MiB")


def main() -> None:
    """Train, recognise, score, print."""
    arguments = parser(__doc__)
    arguments.add_argument("folder", nargs="?")
    arguments.add_argument("--methods", nargs="+", default=["jointnet"])
    arguments.add_argument("--seeds", nargs="+", type=int, default=[1, 2, 3])
    arguments.add_argument("--folds", nargs="+", help="test folds; all without it")
    arguments.add_argument("--jobs", type=int, default=1)
    arguments.add_argument("--changes", type=json.loads, default={})
    arguments.add_argument("--kept", type=Path, default=RESULTS / "sydney_recognition")
    arguments.add_argument("--steps", action="store_true", help="print the names of the steps, and end")
    arguments.add_argument("--sizes", action="store_true", help="print the sizes of networks, and end")
    options = arguments.parse_args()
    if options.steps or options.sizes:
        print(*PATH) if options.steps else print_sizes()
        return
    if options.folder is None:
        arguments.error("the folder of the Sydney Urban Objects is missing")
    folds = read_folds(options.folder)
    tested = options.folds or list(folds)
    runs = {b: (ObjectSet.join([s for a, s in folds.items() if a != b]), folds[b]) for b in tested}
    for slug in options.methods:
        start = time.perf_counter()
        plan = [(seed, name) for seed in options.seeds for name in runs]
        found = Parallel(n_jobs=options.jobs)(
            delayed(recognise)(slug, seed, options.changes, *runs[name], options.kept) for seed, name in plan
        )
        truths = [np.asarray(test.label) for _, test in runs.values()]
        by_seed = [[p for p, _, _ in found[i : i + len(runs)]] for i in range(0, len(found), len(runs))]
        figures = np.array([[weighted_f1(t, p) for t, p in zip(truths, one, strict=True)] for one in by_seed])
        means = figures.mean(axis=1)
        recognised = len(options.seeds) * sum(map(len, truths))
        line = {"method": slug, "changes": options.changes, "weighted_f1": round(float(means.mean()), 4)}
        line |= {"interval": interval(truths, by_seed), "of_seeds": np.round(means, 4).tolist()}
        line |= {"wall_s": round(time.perf_counter() - start, 1)}
        line |= {"of_runs": dict(zip(runs, np.round(figures.mean(axis=0), 4).tolist(), strict=True))}
        line |= {"train_cpu_s_per_seed": round(sum(t for _, t, _ in found) / len(options.seeds), 1)}
        line |= {"recognise_ms_per_object": round(1000 * sum(t for _, _, t in found) / recognised, 3)}
        print(json.dumps(line), flush=True)


if __name__ == "__main__":
    main()

"""Images of luo2019 on the Sydney Urban Objects: a support vector machine on all 15 of them, inner folds.

    python benchmarks/sydney_images.py FOLDER --counts root log share --isotropic
    python benchmarks/sydney_images.py FOLDER --counts root_share log --window 2 4 --bilinear

One fold teaches, another is recognised, in eight headings each, whose scores are summed.
"""

from __future__ import annotations

import argparse
import json
from itertools import permutations

import numpy as np
from numpy.typing import NDArray
from sklearn.metrics import f1_score
from sklearn.svm import SVC
from sydney_recognition import read_folds

from mlsroad_pipeline.algorithms.features.accumulation_images import draw_images
from mlsroad_pipeline.papers.luo2019.jointnet.inputs import Points
from mlsroad_pipeline.papers.shared.recognition.object_set import ObjectSet

N_TURNS, SIZES, SHARE_SCALE = 8, (16, 8, 16), 50.0
COUNTS = ("root", "log", "share", "root_share")


def describe(
    objects: ObjectSet, counts: str, *, isotropic: bool, window: tuple[float, float] | None, bilinear: bool
) -> list[NDArray[np.float32]]:
    points = Points(objects.xyz, objects.indptr, np.zeros(len(objects.xyz)), np.zeros(len(objects), bool))
    n_points = np.diff(objects.indptr)
    weights = SHARE_SCALE / np.repeat(n_points, n_points) if counts.endswith("share") else np.ones(len(objects.xyz))
    found = []
    for turn in range(N_TURNS):
        turned = points.turned(2 * np.pi * turn / N_TURNS).xyz
        images = draw_images(
            turned, objects.indptr, weights, sizes=SIZES, isotropic=isotropic, window=window, bilinear=bilinear
        )
        flat = np.concatenate([image.reshape(len(objects), -1) for image in images], axis=1)
        found.append({"root": np.sqrt, "log": np.log1p, "share": np.asarray, "root_share": np.sqrt}[counts](flat))
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder")
    parser.add_argument("--counts", nargs="+", choices=COUNTS, default=list(COUNTS))
    parser.add_argument("--isotropic", action="store_true", help="one factor for all axes")
    parser.add_argument("--window", nargs=2, type=float, help="half-width and height of one space, metres")
    parser.add_argument("--bilinear", action="store_true", help="a point is shared between the cells around it")
    parser.add_argument("--cost", type=float, default=10.0)
    options = parser.parse_args()
    folds = read_folds(options.folder)
    for counts in options.counts:
        seen = {
            name: describe(
                objects, counts, isotropic=options.isotropic, window=options.window, bilinear=options.bilinear
            )
            for name, objects in folds.items()
        }
        figures = {}
        for a, b in permutations(folds, 2):
            mean = np.mean(seen[a], axis=(0, 1))
            machine = SVC(C=options.cost, gamma="scale")
            machine.fit(np.concatenate(seen[a]) - mean, np.tile(folds[a].label, N_TURNS))
            scores = sum(machine.decision_function(turned - mean) for turned in seen[b])
            named = machine.classes_[np.argmax(scores, axis=1)]
            figures[f"{a} to {b}"] = f1_score(folds[b].label, named, average="weighted", zero_division=0)
        line = {"counts": counts, "isotropic": options.isotropic, "window": options.window, "cost": options.cost}
        line |= {"bilinear": options.bilinear, "weighted_f1": round(float(np.mean(list(figures.values()))), 3)}
        print(json.dumps({**line, **{pair: round(float(f), 3) for pair, f in figures.items()}}), flush=True)


if __name__ == "__main__":
    main()

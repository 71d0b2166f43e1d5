"""Accuracy of recognisers on disturbed test objects of the simulated sets, without the study of Luo et al. 2019.

    kedro run --pipelines=simulated_objects
    python benchmarks/disturbed_objects.py data/05_model_input/simulated_objects --methods jointnet spin_image

Each method is trained once on the training objects of a set; `jointnet` and its sub-networks for 30 epochs, as in the
study. `--changes` changes parameters of the methods, `--recognise train` recognises the training objects instead:

    python benchmarks/disturbed_objects.py FOLDER --methods jointnet --recognise train
        --changes '{"inputs": {"measures": false}, "training": {"epochs": 12, "n_members": 1}}'
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

import numpy as np
from sydney_recognition import parameters_of

from mlsroad_pipeline.papers.luo2019.study.runs import train_and_recognise
from mlsroad_pipeline.papers.shared.recognition.disturbances import PAPER_LEVELS, Disturbance

LEVELS = {
    "undisturbed": Disturbance(),
    **{f"test set {i}": level for i, level in enumerate(PAPER_LEVELS, 1)},
    **{f"noise {value:g}": Disturbance(noise=value) for value in (0.05, 0.1)},
    **{f"kept 1/{share}": Disturbance(keep=1 / share) for share in (4, 16, 64)},
    **{f"outliers {value:g}": Disturbance(outliers=value) for value in (0.1, 0.2, 0.3)},
    **{f"occlusion {value:g}": Disturbance(occlusion=value) for value in (0.1, 0.3)},
}
SHORT = {"training": {"epochs": 30}}


def objects_of(folder: Path, key: str) -> Any:
    with np.load(folder / key / "result.npz") as found:
        return {name: found[name] for name in found.files}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--methods", nargs="+", default=["jointnet", "hierarchy_descriptor", "spin_image", "shot"])
    parser.add_argument("--sets", nargs="+", default=["hdr9", "smd6"])
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--changes", type=json.loads, default={})
    parser.add_argument("--recognise", choices=["train", "validation", "test"], default="test")
    options = parser.parse_args()
    for name in options.sets:
        train, test = (objects_of(options.folder, f"{name}.{split}") for split in ("train", options.recognise))
        print(f"{name}: {len(train['label'])} training objects, {len(test['label'])} objects to recognise", flush=True)
        n_classes = 1 + max(int(part["label"].max()) for part in (train, test))
        for method in options.methods:
            start = time.process_time()
            short = SHORT if method == "jointnet" or method.endswith("_net") else {}
            changes = short | options.changes
            if short:
                changes["training"] = short["training"] | options.changes.get("training", {})
            found = train_and_recognise(
                {"train": train}, test, method=method, settings=[parameters_of(method, options.seed, changes)],
                conditions=LEVELS, disturbance=Disturbance(), wrong_labels=0.0, n_classes=n_classes, seed=2019,
            )["results"]  # fmt: skip
            right = found["scores"].argmax(axis=2) == found["label"]
            accuracy = dict(zip(LEVELS, np.round(right.mean(axis=1), 3).tolist(), strict=True))
            line = {"set": name, "method": method, "accuracy": accuracy, "cpu_s": round(time.process_time() - start)}
            print(json.dumps(line), flush=True)


if __name__ == "__main__":
    main()

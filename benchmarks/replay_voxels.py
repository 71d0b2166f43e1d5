"""Sample of the training voxels of the model `general`, which `mlsroad learn` replays so that nothing is forgotten.

    kedro run --env=general
    python benchmarks/replay_voxels.py [--number 6000] [--store FOLDER] [--write]

Draws simulated voxels of `data/05_model_input/general/boosted_trees/training_set` in proportion to their training
weights; recordings are left out. `--write` replaces the file of the package.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from _common import configured

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.models.boosted_trees.parameters import SLUG
from mlsroad_pipeline.algorithms.models.boosted_trees.sampling import join_voxels
from mlsroad_pipeline.execution.collection import SceneCollection
from mlsroad_pipeline.execution.store import SceneStore
from mlsroad_pipeline.model_store.replay import FILE, write_replay


def main() -> None:
    """Draw the sample, print its classes and write it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--store", type=Path, default=Path(f"data/05_model_input/general/{SLUG}/training_set"))
    parser.add_argument("--number", type=int, default=6000)
    parser.add_argument("--write", action="store_true")
    options = parser.parse_args()
    store = SceneStore(str(options.store))
    scenes = SceneCollection(store, store.stored_records()).load_all()
    scheme = ClassScheme.from_config("road_inventory", configured("classes")["schemes"]["road_inventory"])
    prior = configured(SLUG, "general")["prior"]
    values, allowed, weight = join_voxels(list(scenes.values()), scheme=scheme, prior=prior)
    rng = np.random.default_rng(2026)
    rows = rng.choice(len(values), options.number, replace=False, p=weight / weight.sum())
    for name, count in zip(scheme.classes, allowed[rows].sum(axis=0), strict=True):
        print(f"{name:20} {count}")
    if options.write:
        write_replay(values[rows], allowed[rows], scheme.classes, FILE)
        print(f"{FILE}: {FILE.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()

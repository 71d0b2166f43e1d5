"""How often the classifier of scenes is right: unseen recordings, changed copies of them, and what is no street.

python benchmarks/strange_scenes.py
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from _common import markdown, parser

from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.stage_parameters import GroundParameters
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.models.familiarity import FAMILIAR, KINDS, changes, kind_probabilities, trust
from mlsroad_pipeline.algorithms.stages import find_ground
from mlsroad_pipeline.formats.options import ReadOptions
from mlsroad_pipeline.formats.registry import get_format
from mlsroad_pipeline.model_store.shipped_models import load_shipped

UNSEEN = {
    "Oakland": (
        "oakland/*.xyz_label_conf.gz",
        {"columns": {"x": 0, "y": 1, "z": 2}, "delimiter": "whitespace", "header": False},
    ),
    "SemanticKITTI": ("real/semantickitti_ika/train/*.npz", {}),
    "nuScenes": ("real/nuscenes_lidarseg_ika/train/*.npz", {}),
    "SUSTech": ("sustech/**/*.pcd", {}),
    "Lille": ("real/paris_lille_street/*.ply", {}),
}
STRANGE = {
    "Amsterdam, ground cut away": "amsterdam/*.laz",
    "Amsterdam, ground alone": "real/amsterdam_routes/**/*.laz",
    "ISPRS, airborne": "isprs/*.*",
    "a single tree": "real/adtree_paris_lille_trees/*.xyz",
}
"""Recordings that no shipped model was trained on, and what is no street survey."""

FEWEST = 1000
"""Fewest points of a changed copy."""

STRANGE_BELOW = 0.3
COLUMNS = ["scenes", "number", "called strange", "median factor", "kind named"]


def read(path: Path, options: dict[str, Any]) -> PointCloud:
    """Read a file with its intensity."""
    cloud = get_format(path).read(path, ReadOptions(**{"intensity_scale": "auto", **options}))
    return cloud.without_columns(set(cloud.columns) - {"intensity"})


def row(kind: str, model: ModelBundle, clouds: list[PointCloud]) -> list[str]:
    """Return the share of strange scenes, the median factor of their confidences, and how often the kind is found."""
    found = [probabilities for cloud in clouds if (probabilities := kind_probabilities(model, cloud)) is not None]
    strange = np.mean([each[0] < STRANGE_BELOW for each in found])
    named = np.mean([list(KINDS)[int(each.argmax())] == kind for each in found])
    factor = np.median([trust(each) for each in found])
    return [kind, str(len(found)), f"{strange:.2f}", f"{factor:.2f}", f"{named:.2f}" if kind in KINDS else ""]


def files(root: Path, pattern: str, most: int) -> list[Path]:
    """Return at most so many files of a pattern, evenly spaced."""
    found = sorted(root.glob(pattern))
    return found[:: max(1, -(-len(found) // most))]


def main() -> None:
    """Print the table."""
    options = parser(__doc__)
    options.add_argument("--files", type=int, default=2, help="files of each recording")
    arguments = options.parse_args()
    root, model = Path(os.environ.get("MLSROAD_DATA", "../shared/data")), load_shipped("pool")
    usual = [read(path, how) for pattern, how in UNSEEN.values() for path in files(root, pattern, arguments.files)]
    made: dict[str, list[PointCloud]] = {kind: [] for kind in KINDS}
    rng = np.random.default_rng(1)
    for cloud in usual:
        height = find_ground(cloud, GroundParameters())["height"]
        for kind, change in changes(rng):
            changed = change(cloud, height)
            if len(changed) >= FEWEST:
                made[kind].append(changed)
    made[FAMILIAR] = usual
    made |= {name: [read(path, {}) for path in files(root, pattern, 2)] for name, pattern in STRANGE.items()}
    print(markdown(pd.DataFrame([row(name, model, clouds) for name, clouds in made.items()], columns=COLUMNS)))


if __name__ == "__main__":
    main()

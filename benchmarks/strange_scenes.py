"""How often the classifier of scenes is right: recordings that it never saw, changed copies of them, and no streets.

python benchmarks/strange_scenes.py [--model FOLDER]

Line scans are cut into parts of 30 m with 10 m more on both sides, as `label` cuts them; single scans stay whole.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from _common import DATA, parser

from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.stage_parameters import GroundParameters
from mlsroad_pipeline.algorithms.models.familiarity import FAMILIAR, KINDS, changes, kind_probabilities, trust
from mlsroad_pipeline.algorithms.stages import find_ground
from mlsroad_pipeline.formats.base import ReadOptions
from mlsroad_pipeline.formats.registry import get_format
from mlsroad_pipeline.model_store.shipped_models import FOLDER, load_shipped

OAKLAND = {"columns": {"x": 0, "y": 1, "z": 2}, "delimiter": "whitespace", "header": False}
LINES = {
    "Oakland": ("oakland/*.xyz_label_conf.gz", OAKLAND),
    "Lille": ("real/paris_lille_street/*.ply", {}),
    "Paris": ("real/ign_paris/*.laz", {}),
    "a motorway": ("real/michigan_motorway/*.laz", {}),
}
SCANS = {
    "SemanticKITTI": ("real/semantickitti_ika/train/*.npz", {}),
    "nuScenes": ("real/nuscenes_lidarseg_ika/train/*.npz", {}),
    "SUSTech": ("sustech/*.pcd", {}),
}
STRANGE = {
    "Amsterdam, ground cut away": "amsterdam/*.laz",
    "Amsterdam, ground alone": "real/amsterdam_routes/**/*.laz",
    "ISPRS, airborne": "isprs/*.*",
    "a single tree": "real/adtree_paris_lille_trees/*.xyz",
}
MOST_SCANS, FEWEST, STRANGE_BELOW, LEAST = 6, 1000, 0.3, 0.2


def read(path: Path, options: dict) -> PointCloud:
    """Read the places of the points of a file."""
    return PointCloud(get_format(path).read(path, ReadOptions(**{"intensity_scale": "auto", **options})).xyz)


def parts(cloud: PointCloud) -> Iterator[PointCloud]:
    """Return parts along the main axis."""
    xy = cloud.xyz[:, :2] - cloud.xyz[:, :2].mean(axis=0)
    along = xy @ np.linalg.eigh(np.cov(xy[:: max(1, len(xy) // 100_000)].T))[1][:, 1]
    along -= along.min()
    n = max(1, round(along.max() / 30.0))
    for k in range(n):
        inside = np.abs(along - (k + 0.5) * along.max() / n) < along.max() / n / 2 + 10.0
        if inside.sum() > 2 * FEWEST:
            yield cloud.select(np.flatnonzero(inside))


def main() -> None:
    """Print the tables."""
    options = parser(__doc__)
    options.add_argument("--model", type=Path, default=FOLDER, help="folder of the shipped models")
    model = load_shipped("pool", options.parse_args().model)
    found: dict[str, list] = {}
    for name, (pattern, how) in {**LINES, **SCANS}.items():
        files = sorted(DATA.glob(pattern))
        for path in files if name in LINES else files[:: -(-len(files) // MOST_SCANS)]:
            cloud, rng, shares = read(path, how), np.random.default_rng(1), []
            for scene in parts(cloud) if name in LINES else [cloud]:
                height = find_ground(scene, GroundParameters())["height"]
                made = [(name, scene)] + [(k, c(scene, height)) for k, c in changes(rng) if k != FAMILIAR]
                for kind, changed in made:
                    if len(changed) >= FEWEST and (seen := kind_probabilities(model, changed)) is not None:
                        found.setdefault(kind, []).append(seen)
                        shares += [(len(changed), seen[0] < STRANGE_BELOW)] if kind == name else []
            share = sum(n for n, strange in shares if strange) / sum(n for n, _ in shares)
            if share >= LEAST:
                print(f"{path.name}: warned of, {share:.2f} of the points")
    for name, pattern in STRANGE.items():
        clouds = [read(path, {}) for path in sorted(DATA.glob(pattern))[:2]]
        found[name] = [seen for cloud in clouds if (seen := kind_probabilities(model, cloud)) is not None]
    for name, rows in found.items():
        kind = FAMILIAR if name in LINES or name in SCANS else name
        strange, factor = np.mean([p[0] < STRANGE_BELOW for p in rows]), np.median([trust(p) for p in rows])
        named = np.mean([list(KINDS)[int(p.argmax())] == kind for p in rows]) if kind in KINDS else np.nan
        print(f"{name:28s} {len(rows):4d} strange {strange:.2f} factor {factor:.2f} named {named:.2f}")


if __name__ == "__main__":
    main()

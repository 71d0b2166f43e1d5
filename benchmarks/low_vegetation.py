"""Calibration on a recording without its points of low vegetation: what a class definition costs.

    kedro run --env=recordings
    python benchmarks/low_vegetation.py [--source nuscenes] [--heights 0.2 0.3 0.5] [--scenes FOLDER]

The shipped pool labels the scenes of a recording of conf/recordings, and its labels are scored in common classes: all
points, and all but those of the class vegetation below a height above the ground. nuScenes' vegetation holds grass, on
the ground of which `pool` has the class ground. Prints a Markdown table: points, overall accuracy, mean confidence,
expected calibration error (15 bins).
"""

from __future__ import annotations

import argparse
import logging
from pathlib import Path

import numpy as np
import yaml
from forest_trials import configured
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.core.stage_parameters import GroundParameters
from mlsroad_pipeline.algorithms.metrics.calibration import reliability_table
from mlsroad_pipeline.algorithms.models.bundle import bundle_scheme
from mlsroad_pipeline.algorithms.models.labelling import label_cloud
from mlsroad_pipeline.algorithms.stages import ground_of
from mlsroad_pipeline.execution.collection import SceneCollection
from mlsroad_pipeline.execution.store import SceneStore
from mlsroad_pipeline.model_store.shipped_models import load_shipped
from mlsroad_pipeline.papers.comparison.recordings.scoring import unmixed
from mlsroad_pipeline.papers.comparison.recordings.sources import Source, sources_of
from mlsroad_pipeline.papers.shared.evaluation.labelling import coarse_labels

ROOT = Path(__file__).resolve().parents[1]
SCENES = ROOT / "data/03_primary/recordings/recordings_study/scenes"
COMMON = ClassScheme.from_config("common", configured("classes")["schemes"]["common"])


def labelled(source: Source, folder: Path) -> tuple[NDArray, NDArray, NDArray, NDArray]:
    """Return true class, whether the label is right, confidence and height above the ground of the known points."""
    bundle = load_shipped("pool")
    ground = GroundParameters(**bundle.metadata["parameters"]["ground"])
    store = SceneStore(str(folder))
    records = {key: one for key, one in store.stored_records().items() if key.partition(".")[0] == source.name}
    parts = []
    for key, handle in SceneCollection(store, records).items():
        cloud = handle.load()
        plain = cloud.without_columns(["label", "part"])
        label, confidence = label_cloud(bundle, plain)
        truth = COMMON.encode(cloud["label"], source=key)
        found = unmixed(truth, coarse_labels(label, bundle_scheme(bundle), COMMON), COMMON, source.mixed)
        known = truth >= 0
        height = ground_of(plain, ground)["height"]
        parts.append((truth[known], (found == truth)[known], confidence[known], height[known]))
    truth, right, confidence, height = (np.concatenate(each) for each in zip(*parts, strict=True))
    return truth, right, confidence, height


def row(name: str, right: NDArray, confidence: NDArray) -> str:
    """Return a line of the table."""
    error = reliability_table(np.clip(confidence.astype(np.float64), 0, 1), right).calibration_error
    return f"| {name} | {len(right):,} | {right.mean():.3f} | {confidence.mean():.3f} | {error:.3f} |"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--source", default="nuscenes")
    parser.add_argument("--heights", type=float, nargs="+", default=[0.2, 0.3, 0.5])
    parser.add_argument("--scenes", type=Path, default=SCENES)
    options = parser.parse_args()
    logging.disable(logging.WARNING)
    study = yaml.safe_load((ROOT / "conf/recordings/parameters.yml").read_text(encoding="utf-8"))["recordings_study"]
    truth, right, confidence, height = labelled(sources_of(study["sources"])[options.source], options.scenes)
    vegetation = truth == COMMON.classes.index("vegetation")
    print("| points | number | overall accuracy | mean confidence | calibration error |\n|---|---|---|---|---|")
    print(row("all", right, confidence))
    for limit in options.heights:
        kept = ~(vegetation & (height < limit))
        print(row(f"without vegetation below {limit} m", right[kept], confidence[kept]))
    print(f"{(vegetation & (height < 0.3)).sum() / max(vegetation.sum(), 1):.2f} of the vegetation lies below 0.3 m")


if __name__ == "__main__":
    main()

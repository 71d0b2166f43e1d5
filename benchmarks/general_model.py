"""Scores of the default model on recordings that it was not trained on.

    kedro run --env=general
    python benchmarks/general_model.py [--without pandaset ika] [--sources NAME...] [--json FILE]

Trains the model again from the voxels that `kedro run --env=general` drew: as shipped, and without each of the
recordings that it learns from. Scores every recording of conf/recordings below $MLSROAD_DATA with the model that did
not see it; each file is labelled alone.
"""

from __future__ import annotations

import argparse
import json
import logging
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from _common import configured
from kedro.framework.session import KedroSession
from kedro.framework.startup import bootstrap_project

from mlsroad_pipeline.algorithms.baselines.boosted_trees.parameters import SLUG, BoostedTreesParameters
from mlsroad_pipeline.algorithms.baselines.boosted_trees.training import fit
from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.core.stage_parameters import GroundParameters
from mlsroad_pipeline.algorithms.evaluation.labelling import coarse_labels
from mlsroad_pipeline.algorithms.metrics.calibration import ReliabilityTable
from mlsroad_pipeline.algorithms.metrics.confusion import scores
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle, bundle_scheme
from mlsroad_pipeline.algorithms.models.labelling import label_cloud
from mlsroad_pipeline.pipelines.boosted_trees.nodes import load_lightgbm
from mlsroad_pipeline.studies.recordings.scoring import score_points, unmixed
from mlsroad_pipeline.studies.recordings.sources import Source, sources_of
from mlsroad_pipeline.surveys.recording_scenes import read_points

ROOT = Path(__file__).resolve().parents[1]
LEAST = 100
"""Fewest points of a class that counts in the mean."""


def train(voxels: dict[str, Any], recorded: dict[str, Any], weight: float, without: Sequence[str]) -> ModelBundle:
    """Train the model without some of the recordings."""
    load_lightgbm()
    kept = {key: rows for key, rows in recorded.items() if key.partition(".")[0] not in without}
    own = {**configured(SLUG), **configured(SLUG, "general")}
    schemes = configured("classes")["schemes"]
    scheme, common = (ClassScheme.from_config(name, schemes[name]) for name in ("road_inventory", "common"))
    return fit(
        [*voxels.values(), *kept.values()],
        parameters=BoostedTreesParameters(**own),
        ground=GroundParameters(**configured("ground_removal")),
        scheme=scheme,
        trained_on={},
        sources=["simulated"] * len(voxels) + [key.partition(".")[0] for key in kept],
        weights=[weight] * len(voxels) + [1.0] * len(kept),
        groups=scheme.coarsen(common).tolist(),
        n_threads=2,
    )


def score(source: Source, bundle: ModelBundle, common: ClassScheme, root: Path) -> dict[str, Any]:
    """Label and score all files of a recording."""
    truths, labels, confidences = [], [], []
    for stem, path in source.paths(root).items():
        reference = None if source.labels is None else path.parent / source.labels / f"{stem}.label"
        cloud = read_points(path, reference, source.read_coding(configured("classes")["codings"]), source.read)
        label, confidence = label_cloud(bundle, cloud.without_columns(["label"]))
        truths.append(common.encode(cloud["label"], source=cloud.source))
        labels.append(coarse_labels(label, bundle_scheme(bundle), common))
        confidences.append(confidence)
    truth, label, confidence = (np.concatenate(parts) for parts in (truths, labels, confidences))
    scored = score_points(truth, unmixed(truth, label, common, source.mixed), confidence, len(common))
    found, counts = scores(scored["matrix"]), scored["matrix"].sum(axis=1)
    iou = {
        name: round(float(found.iou[i]), 3)
        for i, name in enumerate(common.classes)
        if name in source.classes and name != "other" and counts[i] >= LEAST
    }
    reliability = ReliabilityTable(scored["bin_counts"], scored["bin_hits"], scored["bin_confidences"])
    return {
        "overall_accuracy": round(float(found.overall_accuracy), 3),
        "mean_iou": round(float(np.mean(list(iou.values()))), 3),
        "calibration_error": round(reliability.calibration_error, 3),
        "auroc": round(float(scored["auroc"]), 3),
        "iou": iou,
    }


def main() -> None:
    """Train and score."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--without", nargs="*", default=["pandaset", "ika"])
    parser.add_argument("--sources", nargs="*")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    logging.disable(logging.WARNING)
    bootstrap_project(ROOT)
    with KedroSession.create(project_path=ROOT, env="general") as session:
        catalog = session.load_context().catalog
        voxels = catalog.load(f"{SLUG}.training_set").load_all()
        recorded = catalog.load("general_model.training_set").load_all()
        shipped = catalog.load("params:shipped")
    study = yaml.safe_load((ROOT / "conf/recordings/parameters.yml").read_text(encoding="utf-8"))["recordings_study"]
    sources = sources_of(study["sources"])
    common = ClassScheme.from_config("common", configured("classes")["schemes"]["common"])
    chosen = [name for name in sources if options.sources is None or name in options.sources]
    unseen = [name for name in chosen if name not in options.without]
    scored: dict[str, Any] = {}
    for without, names in [([], unseen), *(([name], [name]) for name in options.without if name in chosen)]:
        bundle = train(voxels, recorded, shipped.weight, without) if names else None
        for name in names:
            scored[name] = score(sources[name], bundle, common, Path(shipped.root))
            print(name, json.dumps(scored[name]), flush=True)
    if options.json:
        options.json.write_text(json.dumps(scored, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()

"""Length of scenes and of their context against the mean IoU of a shipped model on recordings.

    kedro run --env=recordings --params=recordings_study.protocol=shipped
    python benchmarks/scene_lengths.py [--model pool] [--every 1] [--cuts 0:0:0 30:5:0 60:5:15]

A cut is the length of a core, of its buffers and of the further context, metres, as in docs/scenes.md; 0:0:0 takes each
file as one scene. Files are cut along their main axis. Prints the mean IoU of each recording over the classes that it
has, of the labels of the points before objects are found. `--every 3` takes every third file.
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
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.evaluation.labelling import coarse_labels
from mlsroad_pipeline.algorithms.metrics.confusion import confusion_matrix, scores
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle, bundle_scheme
from mlsroad_pipeline.algorithms.models.labelling import label_cloud
from mlsroad_pipeline.algorithms.scenes.binning import cut_range
from mlsroad_pipeline.algorithms.scenes.corridor import main_axis
from mlsroad_pipeline.algorithms.scenes.joining import assemble_scene
from mlsroad_pipeline.algorithms.scenes.spans import plan_scenes
from mlsroad_pipeline.datasets.models.shipped_models import load_shipped
from mlsroad_pipeline.execution.collection import SceneCollection
from mlsroad_pipeline.execution.store import SceneStore
from mlsroad_pipeline.studies.recordings.scoring import unmixed
from mlsroad_pipeline.studies.recordings.sources import Source, sources_of

ROOT = Path(__file__).resolve().parents[1]
SCENES = "data/03_primary/recordings/recordings_study/scenes"
BIN, MOST_POINTS = 1.0, 1_500_000
COMMON = ClassScheme.from_config("common", configured("classes")["schemes"]["common"])


def label_in_scenes(cloud: PointCloud, bundle: ModelBundle, cut: tuple[float, float, float]) -> NDArray[np.int16]:
    """Label a cloud scene by scene; each point gets its label from the scene with it in the core."""
    length, buffer, context = cut
    if not length:
        return label_cloud(bundle, cloud)[0]
    piece = cut_range(cloud, main_axis(cloud.world_xyz()), bin_length=BIN, first_row=0)
    sizes = {"scene_length": length, "buffer": buffer, "context": context}
    label = np.full(len(cloud), -1, np.int16)
    for span in plan_scenes(piece.histogram(), **sizes, bin_length=BIN, max_points=MOST_POINTS):
        scene = assemble_scene([piece], span)
        core, row = scene["core"], scene["row"]
        found = label_cloud(bundle, scene.without_columns({"core", "near", "row", "file"} & set(scene.columns)))[0]
        label[row[core]] = found[core]
    return label


def mean_iou(source: Source, truths: list[NDArray], labels: list[NDArray]) -> float:
    """Return the mean IoU over the classes of a recording, without `other`."""
    truth, label = np.concatenate(truths), np.concatenate(labels)
    matrix = confusion_matrix(truth, unmixed(truth, label, COMMON, source.mixed), len(COMMON))
    iou = scores(matrix).iou
    return float(np.mean([iou[COMMON.classes.index(name)] for name in source.classes if name != "other"]))


def main() -> None:
    """Print one line per cut."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--model", default="pool")
    parser.add_argument("--every", type=int, default=1)
    parser.add_argument("--cuts", nargs="+", default=["0:0:0", "30:5:0", "60:5:15"])
    parser.add_argument("--scenes", type=Path, default=ROOT / SCENES)
    options = parser.parse_args()
    logging.disable(logging.WARNING)
    study = yaml.safe_load((ROOT / "conf/recordings/parameters.yml").read_text(encoding="utf-8"))["recordings_study"]
    bundle, store = load_shipped(options.model), SceneStore(str(options.scenes))
    trained = bundle_scheme(bundle)
    for cut in options.cuts:
        length, buffer, context = (float(value) for value in cut.split(":"))
        found = {}
        for name, source in sources_of(study["sources"]).items():
            records = {k: r for k, r in store.stored_records().items() if k.partition(".")[0] == name}
            truths, labels = [], []
            for handle in list(SceneCollection(store, records).values())[:: options.every]:
                cloud = handle.load()
                truths.append(COMMON.encode(cloud["label"], source=name))
                plain = cloud.without_columns(["label", "part"])
                labels.append(coarse_labels(label_in_scenes(plain, bundle, (length, buffer, context)), trained, COMMON))
            if truths:
                found[name] = mean_iou(source, truths, labels)
        shown = "  ".join(f"{name} {value:.3f}" for name, value in found.items())
        print(f"{cut:10s} {shown}  mean {np.mean(list(found.values())):.3f}", flush=True)


if __name__ == "__main__":
    main()

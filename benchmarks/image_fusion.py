"""Labels through images, and their fusion with the forest's, on simulated streets: Tables 1 to 5 of Tomic et al. 2019.

Run as ``python benchmarks/image_fusion.py [--seeds N ...] [--steps N] [--weights FILE]``. A network and a forest are
trained on three streets; then, for each seed, a street is scanned, its first half is test set 1 and its second half,
beyond a gap of 10 m, test set 2. ``--weights`` keeps the network in a file and reads it from there the next time.
"""

import argparse
import json
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import yaml

from mlsroad_pipeline.algorithms.classes import ClassScheme
from mlsroad_pipeline.algorithms.detrended_forest.labeller import StageParameters, label_cloud
from mlsroad_pipeline.algorithms.detrended_forest.training import ForestParameters, fit, training_rows
from mlsroad_pipeline.algorithms.image_labels.camera import Camera
from mlsroad_pipeline.algorithms.image_labels.cityscapes import (
    encode_label_image,
    image_classes,
    point_probabilities,
    segmentation_table,
)
from mlsroad_pipeline.algorithms.image_labels.labelling import ImageLabels, label_through_images
from mlsroad_pipeline.algorithms.image_labels.pspnet import PSPNet
from mlsroad_pipeline.algorithms.image_labels.pspnet_training import train_network
from mlsroad_pipeline.algorithms.image_labels.pspnet_weights import from_arrays, to_arrays
from mlsroad_pipeline.algorithms.image_labels.segmentation import segment_image
from mlsroad_pipeline.algorithms.image_labels.training_parameters import TrainingParameters
from mlsroad_pipeline.algorithms.metrics.confusion import confusion_matrix
from mlsroad_pipeline.algorithms.model_bundle import ModelBundle
from mlsroad_pipeline.algorithms.scene_stages import (
    FeatureParameters,
    GroundParameters,
    SupervoxelParameters,
    build_supervoxels,
    describe_supervoxels,
    find_ground,
)
from mlsroad_pipeline.algorithms.simulation import PRESETS, Survey, simulate_survey
from mlsroad_pipeline.algorithms.studies.tomic2019 import TestSet, fuse_test_sets

TRAINING = (501, 502, 503)
"""Seeds of the streets that network and forest are trained on."""

GAP = 10.0
"""Street between the test sets, metres."""


def street(seed: int) -> Survey:
    """Return a scanned and photographed street."""
    return simulate_survey(replace(PRESETS["small"], seed=seed, image_interval=6.0), n_threads=1)


def trained_network(surveys: list[Survey], scheme: ClassScheme, steps: int, weights: Path | None) -> PSPNet:
    """Return a network trained on the surveys' images, or read from a file."""
    n = len(image_classes(scheme))
    if weights is not None and weights.is_file():
        with np.load(weights, allow_pickle=False) as arrays:
            return from_arrays(dict(arrays), n_classes=n, backbone="small")
    samples = [(i.rgb, encode_label_image(i.label, scheme)) for survey in surveys for i in survey.images]
    started = time.process_time()
    network, losses = train_network(samples, n_classes=n, parameters=TrainingParameters(n_steps=steps))
    spent = time.process_time() - started
    print(f"network: {len(samples)} images, {steps} steps, {spent:.0f} s of CPU, loss {np.mean(losses[-50:]):.3f}")
    if weights is not None:
        np.savez(weights, **to_arrays(network))
    return network


def trained_forest(surveys: list[Survey], scheme: ClassScheme) -> ModelBundle:
    """Return a forest trained on the surveys' points."""
    stages = StageParameters(GroundParameters(), SupervoxelParameters(), FeatureParameters())
    rows = []
    for survey in surveys:
        ground = find_ground(survey.cloud, stages.ground)
        supervoxels = build_supervoxels(survey.cloud, stages.supervoxels)
        features = describe_supervoxels(survey.cloud, ground, supervoxels, stages.features)
        rows.append(training_rows(survey.cloud, supervoxels, features, scheme=scheme))
    bundle, _ = fit(rows, parameters=ForestParameters(), stages=stages, scheme=scheme, trained_on={"seeds": TRAINING})
    return bundle


def labelled(survey: Survey, network: PSPNet, forest: ModelBundle, scheme: ClassScheme) -> tuple[TestSet, np.ndarray]:
    """Return what both methods say of a street's points, and the confusion of its pixels."""
    classes = image_classes(scheme)
    pixels = np.zeros((len(classes), len(classes) + 1), dtype=np.int64)

    def segmented():
        for image in survey.images:
            given = segment_image(network, image.rgb)
            truth = encode_label_image(image.label, scheme)
            pixels[:] += confusion_matrix(truth.ravel(), given.argmax(axis=2).ravel(), len(classes))
            camera = Camera(image.K, image.distortion, image.R, image.t, image.width, image.height)
            flat = point_probabilities(given.reshape(-1, len(classes)), classes, scheme)
            yield image.camera, camera, flat.reshape(*given.shape[:2], len(scheme))

    groups = sorted({image.camera for image in survey.images})
    images = label_through_images(survey.cloud.xyz, segmented(), groups=groups, n_classes=len(scheme))
    labels, confidence = label_cloud(survey.cloud, forest)
    return TestSet(scheme.encode(survey.cloud["label"]), labels, confidence, images), pixels


def halves(whole: TestSet, survey: Survey) -> tuple[TestSet, TestSet]:
    """Cut a street into test sets 1 and 2 along the road."""
    station, _ = survey.street.alignment.locate(survey.cloud.xyz[:, :2].astype(np.float64))
    middle = (station.min() + station.max()) / 2
    parts = []
    for rows in (station < middle - GAP / 2, station > middle + GAP / 2):
        images = ImageLabels(
            whole.images.groups, whole.images.probabilities[:, rows], whole.images.n_images[:, rows]
        )  # fmt: skip
        parts.append(TestSet(whole.reference[rows], whole.labels[rows], whole.confidence[rows], images))
    return parts[0], parts[1]


def main() -> None:
    """Run the experiment."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", nargs="+", type=int, default=[601, 602, 603])
    parser.add_argument("--steps", type=int, default=1000)
    parser.add_argument("--weights", type=Path)
    options = parser.parse_args()
    schemes = yaml.safe_load((Path(__file__).parents[1] / "conf/base/parameters_classes.yml").read_text())
    scheme = ClassScheme.from_config("tomic2019", schemes["classes"]["schemes"]["tomic2019"])
    surveys = [street(seed) for seed in TRAINING]
    network = trained_network(surveys, scheme, options.steps, options.weights)
    forest = trained_forest(surveys, scheme)
    for seed in options.seeds:
        survey = street(seed)
        whole, pixels = labelled(survey, network, forest, scheme)
        study = fuse_test_sets(*halves(whole, survey), classes=scheme.classes)
        table = segmentation_table(pixels, image_classes(scheme))
        print(f"\nstreet {seed}: IoU of pixels\n{table.to_string(index=False)}")
        print(f"F1 on test set 1\n{study.camera_f1.T.round(3).to_string()}\n{study.method_f1.T.round(3).to_string()}")
        print(f"redundancy\n{study.redundancy}\n{study.scores[study.scores['class'] == 'all'].to_string(index=False)}")
        for row in study.scores[study.scores["class"] == "all"].to_dict("records"):
            print(json.dumps({"stage": "image_fusion", "seed": seed, **row}), flush=True)


if __name__ == "__main__":
    main()

"""Checks of labelled files: standard codes, confidences, and all points and attributes of the original."""

import laspy
import numpy as np
from helpers.wiring import REPOSITORY
from helpers.yaml_files import read_yaml

from mlsroad_pipeline.algorithms.core.classes import ClassScheme

N_POINTS = 9000
UNCLASSIFIED, NOISE = 1, 7


def scheme(name="road_inventory"):
    configured = read_yaml(REPOSITORY / "conf/base/parameters_classes.yml")
    return configured["classes"]["schemes"][name]


def asprs_codes():
    return {spec["asprs"] for spec in scheme()["classes"].values()} | {UNCLASSIFIED, NOISE}


def check_labels(las, n_points):
    codes, confidence = np.asarray(las.classification), np.asarray(las["confidence"])
    assert len(codes) == n_points
    assert set(np.unique(codes).tolist()) <= asprs_codes()
    assert confidence.dtype == np.float32 and confidence.min() >= 0 and confidence.max() <= 1
    return codes, confidence


def check_same_points(written, original):
    """Check that the result has every dimension of the original, in the same order."""
    for name in original.point_format.dimension_names:
        if name in ("classification", "scan_angle_rank", "raw_classification"):
            continue
        assert np.array_equal(np.asarray(written[name]), np.asarray(original[name])), name
    for axis in "XYZ":
        assert np.array_equal(written[axis], original[axis])
    assert np.array_equal(written.header.scales, original.header.scales)
    assert np.array_equal(written.header.offsets, original.header.offsets)


def write_true_classes(path):
    """Write the classes of the simulator to a survey's file as codes of the inventory's classes."""
    given, las = ClassScheme.from_config("road_inventory", scheme()), laspy.read(path)
    label = given.encode(np.asarray(las["label"]))
    las.classification = np.where(label < 0, UNCLASSIFIED, given.codes()[label])
    las.write(path)

"""Planted objects, and quickly trained models of all recognisers."""

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.core.stage_parameters import GroundParameters
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.segmentation.normalized_cut import NormalizedCutParameters
from mlsroad_pipeline.algorithms.segmentation.stage import SegmentationParameters
from mlsroad_pipeline.papers.luo2019.jointnet.parameters import JointNetParameters
from mlsroad_pipeline.papers.luo2019.pointnet.parameters import PointNetParameters
from mlsroad_pipeline.papers.shared.detection.detector import DetectionStages
from mlsroad_pipeline.papers.shared.recognition import cutting as recognition_objects
from mlsroad_pipeline.papers.shared.recognition import recogniser as recognisers
from mlsroad_pipeline.papers.shared.recognition.descriptor_machine import DescriptorParameters
from mlsroad_pipeline.papers.shared.recognition.object_set import ObjectSet

SCHEME = ClassScheme(
    "test", ("pole", "car", "bin", "other"), (("light_pole",), ("car",), ("bin",), ("road", "tree")), ("unlabelled",), (64, 66, 67, 1)
)  # fmt: skip
SEGMENTATION = SegmentationParameters(
    method="euclidean", min_points=1, normalized_cut=NormalizedCutParameters(tolerance=0.8)
)
RECOGNITION = recognition_objects.RecognitionParameters(scheme="test", min_points=20)
MACHINE = DescriptorParameters(radii=[0.0], costs=[10.0], gammas=[0.01], n_folds=2)
NETWORK = {"n_members": 1, "n_turns": 1, "epochs": 25}
PARAMETERS = {
    "jointnet": JointNetParameters(training=NETWORK),
    "spin_image": MACHINE,
    "shot": MACHINE,
    "hierarchy_descriptor": MACHINE,
    "pointnet": PointNetParameters(n_points=32, widths=[16, 16, 32], hidden=[16, 16], epochs=25, learning_rate=0.01),
}
"""JointNet and its four baselines, with settings for planted objects."""


def pole(rng, place, n=60):
    return rng.normal(size=(n, 3)) * [0.05, 0.05, 0] + rng.uniform([0, 0, 0.1], [0, 0, 5.0], (n, 3)) + place


def car(rng, place, n=120):
    return rng.uniform([-2, -0.8, 0.2], [2, 0.8, 1.5], (n, 3)) + place


def training_set(rng, n=8):
    objects = [make(rng, rng.uniform(-40, 40, 3)) for _ in range(n) for make in (pole, car)]
    return ObjectSet.from_objects(objects, [0, 1] * n)


def trained(rng, slug="hierarchy_descriptor", parameters=None, *, min_points=20) -> ModelBundle:
    """Train a method on planted poles and cars."""
    return recognisers.train_recogniser(
        [training_set(rng).to_arrays()],
        slug=slug,
        parameters=PARAMETERS[slug] if parameters is None else parameters,
        recognition=recognition_objects.RecognitionParameters(scheme="test", min_points=min_points),
        stages=DetectionStages(GroundParameters(), SEGMENTATION),
        scheme=SCHEME,
        trained_on={"survey": "planted"},
    )

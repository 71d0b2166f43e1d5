"""Worker functions of the study of Luo et al. 2016: cut streets into patches, count objects, train and score."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any, TypedDict

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.stage_results import Ground
from mlsroad_pipeline.algorithms.metrics.confusion import confusion_matrix
from mlsroad_pipeline.algorithms.models.machines.class_balance import majority_labels
from mlsroad_pipeline.papers.luo2016.max_margin_markov.classifier import MaxMarginMarkov
from mlsroad_pipeline.papers.luo2016.patch_forest.classifier import PatchForest
from mlsroad_pipeline.papers.luo2016.patch_graph.classifier import PatchGraphClassifier
from mlsroad_pipeline.papers.luo2016.patch_graph.labeller import ground_classes
from mlsroad_pipeline.papers.luo2016.patch_graph.refined_classifier import refine_classifier
from mlsroad_pipeline.papers.luo2016.patch_svm.classifier import PatchSvm
from mlsroad_pipeline.papers.luo2016.shape_based import labeller as shape_based
from mlsroad_pipeline.papers.shared.patches.extraction import PatchParameters
from mlsroad_pipeline.papers.shared.patches.labelling import build_patches, label_patches
from mlsroad_pipeline.papers.shared.patches.table import Patches
from mlsroad_pipeline.papers.shared.patches.training import join_training_scenes
from mlsroad_pipeline.papers.shared.patches.types import PatchLabels, PatchStages, ScenePatches
from mlsroad_pipeline.papers.shared.patches.voting import vote_on_points
from mlsroad_pipeline.papers.shared.studies.streets import timed

GRAPH, REFINED = "patch_graph", "patch_graph_mrf"
PRINTED, PRINTED_REFINED = "patch_graph_printed", "patch_graph_mrf_printed"
METHODS = (
    "patch_svm", "patch_forest", "shape_based", "max_margin_markov", PRINTED, PRINTED_REFINED, GRAPH, REFINED,
)  # fmt: skip
"""The methods in the order of the paper's Table III; the last two are the improved ones."""

AS_PRINTED = (PRINTED, PRINTED_REFINED)
"""Methods on the patches of the paper."""

REFINES = {PRINTED: PRINTED_REFINED, GRAPH: REFINED}
"""Label transfer to its refinement."""

RUNS = tuple(method for method in METHODS if method not in REFINES.values())
"""Trained methods: one run gives label transfer and its refinement."""

LEAST_POINTS = 100
"""Fewest points of an object that is counted; most objects with fewer are cut off at an end of the street."""


class StreetCounts(TypedDict):
    """Counts of a street by class, each of shape (classes,)."""

    points: NDArray[np.int64]
    objects: NDArray[np.int64]  # instances of the simulator
    touching: NDArray[np.int64]  # objects with a patch beside a patch of another object


def count_street(points: PointCloud, patches: ScenePatches, scheme: ClassScheme) -> StreetCounts:
    """Count the points and objects of each class; ground has no objects."""
    labels, n = scheme.encode(points["label"], source=points.source), len(scheme)
    names, instance = np.unique(points["instance"], return_inverse=True)
    whole = np.bincount(instance) >= LEAST_POINTS
    kinds, _ = majority_labels(labels, instance, n)
    counted = whole & (names > 0) & (kinds >= 0)
    owner = patches["patch_of_point"]
    known = owner >= 0
    objects = np.full(len(patches["height"]), -1)
    most, _ = majority_labels(instance[known], owner[known], len(names))
    objects[: len(most)] = most
    pairs = objects[patches["edges"]]
    both = pairs[(pairs[:, 0] != pairs[:, 1]) & counted[pairs].all(axis=1)]
    near = np.zeros(len(names), np.bool_)
    near[both] = True
    return {
        "points": np.bincount(labels[labels >= 0], minlength=n),
        "objects": np.bincount(kinds[counted], minlength=n),
        "touching": np.bincount(kinds[counted & near], minlength=n),
    }


class CutStreet(TypedDict):
    """Patches of a street and their classes, from `cut_patches`, and the counts of Table I."""

    patches: ScenePatches
    labels: PatchLabels
    counts: StreetCounts


class Street(TypedDict):
    """Points of a street, with ground and heights, and its patches."""

    points: PointCloud
    patches: ScenePatches
    labels: PatchLabels


class RunResult(TypedDict):
    """Scores and times of the methods of one run."""

    # (streets, classes, classes + 1): method to the confusion matrix of each test street
    matrices: dict[str, NDArray[np.int64]]
    # one row per method: `train_seconds` and `label_seconds` (CPU time), and facts of the trained model
    facts: pd.DataFrame
    # method to the labels of the points of the first test street; empty for runs without picture
    pictured: dict[str, NDArray[np.int8]]


def cut_patches(points: PointCloud, *, sizes: PatchParameters, scheme: ClassScheme) -> CutStreet:
    """Cut a street into patches and assign their classes and stations."""
    patches = build_patches(points, _ground(points), sizes)
    owner = patches["patch_of_point"]
    station = np.bincount(owner, weights=points["station"]) / np.bincount(owner)
    labels = label_patches(points, patches, scheme, station=station)
    return {"patches": patches, "labels": labels, "counts": count_street(points, patches, scheme)}


class _Tally:
    """Confusion matrices and times of the methods of one run."""

    def __init__(self, scheme: ClassScheme, *, pictured: bool) -> None:
        self.scheme = scheme
        self.pictured = pictured
        self.labels: dict[str, NDArray[np.int8]] = {}
        self.matrices: dict[str, list[NDArray[np.int64]]] = {}
        self.facts: dict[str, dict[str, Any]] = {}

    def add(self, method: str, *, train_seconds: float, **facts: Any) -> None:
        self.matrices[method] = []
        self.facts[method] = {"train_seconds": train_seconds, "label_seconds": 0.0, **facts}

    def count(self, method: str, points: PointCloud, labels: NDArray[np.integer], seconds: float) -> None:
        truth = self.scheme.encode(points["label"], source=points.source)
        self.matrices[method].append(confusion_matrix(truth, labels, len(self.scheme)))
        self.facts[method]["label_seconds"] += seconds
        if self.pictured:
            self.labels.setdefault(method, labels.astype(np.int8))

    def result(self) -> RunResult:
        frame = pd.DataFrame([{"method": name, **facts} for name, facts in self.facts.items()])
        matrices = {name: np.array(each) for name, each in self.matrices.items()}
        return {"matrices": matrices, "facts": frame, "pictured": self.labels}


def train_and_score(
    train: Mapping[str, Street],
    test: Mapping[str, Street],
    *,
    method: str,
    parameters: Mapping[str, Any],
    stages: PatchStages,
    scheme: ClassScheme,
    pictured: bool = False,
) -> RunResult:
    """Train a method and score it at full resolution."""
    tally = _Tally(scheme, pictured=pictured)
    if method == shape_based.SLUG:
        _run_objects(tally, train, test, parameters[method], stages)
        return tally.result()
    joined = join_training_scenes(
        {key: street["patches"] for key, street in train.items()},
        {key: street["labels"] for key, street in train.items()},
    )
    if method in REFINES:
        _run_graph(tally, joined, test, method, parameters, stages, len(train))
    else:
        _run_patches(tally, joined, test, method, parameters[method], stages)
    return tally.result()


def _test_streets(
    test: Mapping[str, Street], stages: PatchStages
) -> Iterator[tuple[PointCloud, Patches, NDArray[np.int32], Callable[[NDArray], NDArray[np.int16]]]]:
    """Yield points, patches and edges of each test street, and a function from patch probabilities to point labels."""
    for street in test.values():
        points, patches = street["points"], Patches.from_arrays(street["patches"])

        def vote(probabilities: NDArray, points: PointCloud = points, patches: Patches = patches) -> NDArray[np.int16]:
            radius = stages.patches.area_radius
            return vote_on_points(points.xyz, patches.centroid, probabilities, radius=radius)[0]

        yield points, patches, street["patches"]["edges"], vote


def _run_patches(
    tally: _Tally,
    joined: tuple[Patches, NDArray[np.int32]],
    test: Mapping[str, Street],
    method: str,
    parameters: Any,
    stages: PatchStages,
) -> None:
    n_classes = len(tally.scheme)
    kinds = {"patch_svm": PatchSvm, "patch_forest": PatchForest, "max_margin_markov": MaxMarginMarkov}
    fit: Any = kinds[method].fit
    classifier, seconds = timed(fit, *joined, parameters=parameters, n_classes=n_classes)
    choice = getattr(classifier, "choice", None)
    facts = {} if choice is None else {"cost": choice.cost, "gamma": choice.gamma}
    tally.add(method, train_seconds=seconds, **facts)
    for points, patches, edges, vote in _test_streets(test, stages):
        probabilities, first = timed(classifier.predict_proba, patches, edges)
        labels, second = timed(vote, probabilities)
        tally.count(method, points, labels, first + second)


def _run_graph(
    tally: _Tally,
    joined: tuple[Patches, NDArray[np.int32]],
    test: Mapping[str, Street],
    method: str,
    parameters: Mapping[str, Any],
    stages: PatchStages,
    n_streets: int,
) -> None:
    ground, refinement = ground_classes(tally.scheme), REFINES[method]
    transfer, seconds = timed(PatchGraphClassifier.fit, *joined, len(tally.scheme), parameters=parameters[method])
    (refined, _), more = timed(
        refine_classifier, transfer, *joined, graph_parameters=parameters[method], grid=parameters[refinement],
        ground=ground, surveys=np.arange(n_streets, dtype=np.int32),
    )  # fmt: skip
    objective = transfer.graph.objective
    facts = {"objective": float(objective[-1]), "iterations": len(objective) - 1, "nodes": len(transfer.graph.labels)}
    chosen = {name: getattr(refined.parameters, name) for name in ("smoothness", "colour_decay", "clique_weight")}
    tally.add(method, train_seconds=seconds, **facts)
    tally.add(refinement, train_seconds=seconds + more, **facts, **chosen)
    for points, patches, edges, vote in _test_streets(test, stages):
        transferred, first = timed(transfer.predict_proba, patches, edges)
        labels, second = timed(vote, transferred)
        tally.count(method, points, labels, first + second)
        (_, field), third = timed(refined.refine, transferred, patches, edges)
        labels, fourth = timed(vote, field)
        tally.count(refinement, points, labels, first + third + fourth)


def _run_objects(
    tally: _Tally,
    train: Mapping[str, Street],
    test: Mapping[str, Street],
    parameters: shape_based.ShapeParameters,
    stages: PatchStages,
) -> None:
    def learn() -> Any:
        rows = [
            shape_based.training_objects(
                s["points"], _ground(s["points"]), s["patches"], scheme=tally.scheme, parameters=parameters
            )
            for s in train.values()
        ]
        return shape_based.fit(rows, parameters=parameters, stages=stages, scheme=tally.scheme, trained_on={})

    bundle, seconds = timed(learn)
    tally.add(shape_based.SLUG, train_seconds=seconds, classes_given=", ".join(bundle.metadata["classes_given"]))
    for street in test.values():
        points = street["points"]
        labels, used = timed(shape_based.label_objects, points, _ground(points), street["patches"], bundle)
        tally.count(shape_based.SLUG, points, labels["label"], used)


def _ground(points: PointCloud) -> Ground:
    return {"ground": points["ground"], "height": points["height"]}

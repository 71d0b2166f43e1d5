"""Worker functions of the study of Luo et al. 2016: cut streets into patches, count objects, train and score."""

from collections.abc import Callable, Mapping
from typing import Any, TypedDict

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.stage_results import Ground
from mlsroad_pipeline.algorithms.metrics.confusion import confusion_matrix
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.models.machines.class_balance import majority_labels
from mlsroad_pipeline.papers.luo2016.max_margin_markov.classifier import MaxMarginMarkov
from mlsroad_pipeline.papers.luo2016.patch_forest.classifier import PatchForest
from mlsroad_pipeline.papers.luo2016.patch_graph.classifier import PatchGraphClassifier
from mlsroad_pipeline.papers.luo2016.patch_graph.refined_classifier import ground_classes, refine_classifier
from mlsroad_pipeline.papers.luo2016.patch_svm.classifier import PatchSvm
from mlsroad_pipeline.papers.luo2016.shape_based import labeller as shape_based
from mlsroad_pipeline.papers.shared.patches.extraction import PatchLabels, PatchParameters, PatchStages, ScenePatches
from mlsroad_pipeline.papers.shared.patches.labelling import build_patches, label_patches
from mlsroad_pipeline.papers.shared.patches.table import Patches
from mlsroad_pipeline.papers.shared.patches.training import join_training_scenes
from mlsroad_pipeline.papers.shared.patches.voting import vote_on_points
from mlsroad_pipeline.papers.shared.studies.streets import timed

GRAPH, REFINED = "patch_graph", "patch_graph_mrf"
PRINTED, PRINTED_REFINED = "patch_graph_printed", "patch_graph_mrf_printed"
BASELINES = ("patch_svm", "patch_forest", "shape_based", "max_margin_markov")
CONFIGURED = (*BASELINES, PRINTED, PRINTED_REFINED, GRAPH, REFINED)
"""Methods with parameters of their own, in the order of the paper's Table III; the last two are the improved ones."""

PRINTED_BASELINES = {f"{method}_printed": method for method in BASELINES}
"""Baselines on the paper's histograms without tuning, to their methods."""

METHODS = (*BASELINES, *PRINTED_BASELINES, *CONFIGURED[len(BASELINES) :])
"""The rows of Table III."""

AS_PRINTED = (PRINTED, PRINTED_REFINED, *PRINTED_BASELINES)
"""Methods on the patches of the paper."""

REFINES = {PRINTED: PRINTED_REFINED, GRAPH: REFINED}
"""Label transfer to its refinement."""

RUNS = tuple(method for method in METHODS if method not in REFINES.values())
"""Trained methods: one run gives label transfer and its refinement."""

LEAST_POINTS = 100
"""Fewest points of an object that is counted; most objects with fewer are cut off at an end of the street."""


def count_street(points: PointCloud, patches: ScenePatches, scheme: ClassScheme) -> dict[str, NDArray[np.int64]]:
    """Count the points, the objects, and those objects that touch another one, by class; ground has no objects."""
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


def cut_patches(points: PointCloud, *, sizes: PatchParameters, scheme: ClassScheme) -> dict[str, Any]:
    """Cut a street into patches, assign their classes and stations, and return them with the counts of Table I."""
    patches = build_patches(points, _ground(points), sizes)
    owner = patches["patch_of_point"]
    station = np.bincount(owner, weights=points["station"]) / np.bincount(owner)
    labels = label_patches(points, patches, scheme, station=station)
    return {"patches": patches, "labels": labels, "counts": count_street(points, patches, scheme)}


Labelling = Callable[[Street], dict[str, tuple[NDArray[np.integer], float]]]
"""Function of a test street to the labels of its points by each method of a run, and their CPU time."""

Trained = tuple[dict[str, dict[str, Any]], Labelling]
"""Facts of each method of a run, and the function that labels streets with them."""


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
    kind = PRINTED_BASELINES.get(method, method)
    fit = _train_objects if kind == shape_based.SLUG else _train_graph if method in REFINES else _train_patches
    facts, label = fit(train, method, parameters, stages, scheme)
    matrices: dict[str, list[NDArray[np.int64]]] = {name: [] for name in facts}
    seconds, shown = dict.fromkeys(facts, 0.0), dict[str, NDArray[np.int8]]()
    for street in test.values():
        truth = scheme.encode(street["points"]["label"], source=street["points"].source)
        for name, (labels, used) in label(street).items():
            matrices[name].append(confusion_matrix(truth, labels, len(scheme)))
            seconds[name] += used
            if pictured:
                shown.setdefault(name, labels.astype(np.int8))
    rows = [
        {"method": name, "train_seconds": own.pop("train_seconds"), "label_seconds": seconds[name], **own}
        for name, own in facts.items()
    ]
    counted = {name: np.array(each) for name, each in matrices.items()}
    return {"matrices": counted, "facts": pd.DataFrame(rows), "pictured": shown}


def _joined(train: Mapping[str, Street]) -> tuple[Patches, NDArray[np.int32]]:
    patches = {key: street["patches"] for key, street in train.items()}
    return join_training_scenes(patches, {key: street["labels"] for key, street in train.items()})


def _table(street: Street) -> tuple[Patches, NDArray[np.int32]]:
    return Patches.from_arrays(street["patches"]), street["patches"]["edges"]


def _vote(street: Street, probabilities: NDArray, stages: PatchStages) -> NDArray[np.int16]:
    centroids, radius = street["patches"]["centroid"], stages.patches.area_radius
    return vote_on_points(street["points"].xyz, centroids, probabilities, radius=radius)[0]


def _train_patches(
    train: Mapping[str, Street], method: str, parameters: Mapping[str, Any], stages: PatchStages, scheme: ClassScheme
) -> Trained:
    kinds: dict[str, Any] = {"patch_svm": PatchSvm, "patch_forest": PatchForest, "max_margin_markov": MaxMarginMarkov}
    joined, kind = _joined(train), kinds[PRINTED_BASELINES.get(method, method)]
    classifier, seconds = timed(kind.fit, *joined, parameters=parameters[method], n_classes=len(scheme))
    choice = getattr(classifier, "choice", None)
    facts = {} if choice is None else {"cost": choice.cost, "gamma": choice.gamma}

    def label(street: Street) -> dict[str, Any]:
        probabilities, first = timed(classifier.predict_proba, *_table(street))
        labels, second = timed(_vote, street, probabilities, stages)
        return {method: (labels, first + second)}

    return {method: {"train_seconds": seconds, **facts}}, label


def _train_graph(
    train: Mapping[str, Street], method: str, parameters: Mapping[str, Any], stages: PatchStages, scheme: ClassScheme
) -> Trained:
    joined, refinement, own = _joined(train), REFINES[method], parameters[method]
    transfer, seconds = timed(PatchGraphClassifier.fit, *joined, len(scheme), parameters=own)
    (refined, _), more = timed(
        refine_classifier, transfer, *joined, graph_parameters=own, grid=parameters[refinement],
        ground=ground_classes(scheme), surveys=np.arange(len(train), dtype=np.int32),
    )  # fmt: skip
    objective = transfer.graph.objective
    facts = {"objective": float(objective[-1]), "iterations": len(objective) - 1, "nodes": len(transfer.graph.labels)}
    chosen = {name: getattr(refined.parameters, name) for name in ("smoothness", "colour_decay", "clique_weight")}

    def label(street: Street) -> dict[str, Any]:
        patches, edges = _table(street)
        transferred, first = timed(transfer.predict_proba, patches, edges)
        labels, second = timed(_vote, street, transferred, stages)
        (_, field), third = timed(refined.refine, transferred, patches, edges)
        smooth, fourth = timed(_vote, street, field, stages)
        return {method: (labels, first + second), refinement: (smooth, first + third + fourth)}

    with_field = {"train_seconds": seconds + more, **facts, **chosen}
    return {method: {"train_seconds": seconds, **facts}, refinement: with_field}, label


def _train_objects(
    train: Mapping[str, Street], method: str, parameters: Mapping[str, Any], stages: PatchStages, scheme: ClassScheme
) -> Trained:
    own = parameters[method]

    def learn() -> ModelBundle:
        rows = [
            shape_based.training_objects(s["points"], _ground(s["points"]), s["patches"], scheme=scheme, parameters=own)
            for s in train.values()
        ]
        return shape_based.fit(rows, parameters=own, stages=stages, scheme=scheme, trained_on={})

    def label(street: Street) -> dict[str, Any]:
        points = street["points"]
        labels, used = timed(shape_based.label_objects, points, _ground(points), street["patches"], bundle)
        return {method: (labels["label"], used)}

    bundle, seconds = timed(learn)
    given = ", ".join(bundle.metadata["classes_given"])
    return {method: {"train_seconds": seconds, "classes_given": given}}, label


def _ground(points: PointCloud) -> Ground:
    return {"ground": points["ground"], "height": points["height"]}

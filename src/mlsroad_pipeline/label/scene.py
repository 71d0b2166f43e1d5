"""Labels and objects of one scene of a new survey."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NotRequired, TypedDict

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.stage_parameters import GroundParameters
from mlsroad_pipeline.algorithms.core.stage_results import Ground
from mlsroad_pipeline.algorithms.geometry.thinning import first_in_cells
from mlsroad_pipeline.algorithms.inventory.lines.barriers import barrier_cells
from mlsroad_pipeline.algorithms.inventory.lines.kerbs.kerb_lines import (
    StepLimits,
    ground_classes,
    kerb_steps,
    no_steps,
)
from mlsroad_pipeline.algorithms.inventory.lines.markings.brightness import scanner_pass_of
from mlsroad_pipeline.algorithms.inventory.lines.markings.marking_lines import (
    marking_stripes,
    no_stripes,
    paved_classes,
)
from mlsroad_pipeline.algorithms.inventory.lines.wires import wire_points, wire_probability
from mlsroad_pipeline.algorithms.inventory.objects.candidate_table import candidate_rules
from mlsroad_pipeline.algorithms.inventory.objects.class_groups import ClassEvidence, evidence_of_soft_labels
from mlsroad_pipeline.algorithms.inventory.objects.doubts import Cells, doubtful_clusters
from mlsroad_pipeline.algorithms.inventory.objects.extraction import SceneObjects, extract_objects
from mlsroad_pipeline.algorithms.inventory.objects.object_classifier import ObjectClassifier
from mlsroad_pipeline.algorithms.inventory.objects.rules import ObjectRule
from mlsroad_pipeline.algorithms.inventory.objects.sightings import sightings_of_scene
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle, bundle_scheme
from mlsroad_pipeline.algorithms.models.familiarity import kind_probabilities, trust
from mlsroad_pipeline.algorithms.models.labelling import Labeller, SoftLabels, label_softly
from mlsroad_pipeline.algorithms.scenes.joining import SceneSpan, join_pieces
from mlsroad_pipeline.algorithms.scenes.parameters import OutlierParameters
from mlsroad_pipeline.algorithms.stages import inliers
from mlsroad_pipeline.label.alignment import PassMove, aligned
from mlsroad_pipeline.label.confidence import count_confidences
from mlsroad_pipeline.label.given_classes import (
    GivenClasses,
    contradictions,
    ground_of_scene,
    kept_codes,
    labels_with_given,
    with_given,
)
from mlsroad_pipeline.model_store.object_classifiers import classifier_of

VOXEL = 0.1
"""Edge length of the voxels that keep one point each, metres."""
MOST_POINTS = 150_000
"""Largest number of points of a scene; of more voxels, evenly spaced ones are kept."""
MOST_BELOW = 0.5
"""Depth below the ground from which points belong to no object, metres: a wet road reflects what stands on it."""


class PictureSample(TypedDict):
    """Points of a scene and its buffers, relative to `origin`: label (-1 without a class), whether in the core."""

    xyz: NDArray[np.float32]
    origin: NDArray[np.float64]
    label: NDArray[np.int16]
    core: NDArray[np.bool_]


def scene_sample(
    xyz: NDArray[np.floating], origin: NDArray[np.float64], label: NDArray[np.integer], core: NDArray[np.bool_]
) -> PictureSample:
    """Return the first point of each voxel, in the order of the scene."""
    first = first_in_cells(xyz, VOXEL)
    kept = first[:: max(1, -(-len(first) // MOST_POINTS))]
    return {
        "xyz": xyz[kept].astype(np.float32),
        "origin": np.asarray(origin, dtype=np.float64),
        "label": label[kept].astype(np.int16),
        "core": core[kept],
    }


@dataclass(frozen=True)
class LabelSettings:
    """Settings that all scenes of a survey share."""

    codes: NDArray[np.uint8]  # LAS code of each class of the model
    rules: Mapping[str, ObjectRule]  # Object rules of the inventory
    # Parameters of the ground filter, for models that store none
    ground: GroundParameters = field(default_factory=GroundParameters)
    # Parameters of the statistical outlier filter
    outliers: OutlierParameters = field(default_factory=OutlierParameters)
    # SHA256 of the object classifier of the package, which gives the scores unless the model has one of its own; empty:
    # the score is the mean confidence
    classifier: str = ""
    kerbs: StepLimits | None = None  # Limits of a kerb's step; None finds no kerbs
    # Least contrast of a marking, standard deviations of the road; None finds no markings
    least_contrast: float | None = None
    given: GivenClasses | None = None  # Class maps of the classes that the survey comes with
    moves: tuple[PassMove, ...] = ()  # Moves of the files and passes that lie apart


class CoreLabels(TypedDict):
    """Labels of the points in the core of a scene, ordered by file and row.

    `label` is the class of the model; the number of classes stands for no class, and one more for an outlier. `part` is
    the object as in `SceneObjects`, `kept` the class number of a point that keeps its class, else 0.
    """

    file: NDArray[np.integer]
    row: NDArray[np.int64]
    label: NDArray[np.uint8]
    confidence: NDArray[np.float32]
    part: NDArray[np.int32]
    kept: NotRequired[NDArray[np.uint8]]


class FileSpans(TypedDict):
    """Files of a scene: one line of file number, first row and last row per file."""

    spans: NDArray[np.int64]


class LabelCounts(TypedDict):
    """Point counts of a scene: per class and unlabelled, per class and confidence bin, in an image.

    `kinds` are the probabilities of the kinds of scenes, for models that can tell; `given` as of `contradictions`;
    `below` the number of points of objects that lie below the ground.
    """

    counts: NDArray[np.int64]
    confidences: NDArray[np.int64]
    kinds: NotRequired[NDArray[np.float64]]
    seen: NotRequired[NDArray[np.int64]]
    given: NotRequired[NDArray[np.int64]]
    below: NotRequired[NDArray[np.int64]]


class LabelledScene(TypedDict):
    """Stored parts of a labelled scene.

    `objects`, `fragments` and `evidence` are those of `SceneObjects`, `kerbs` the steps of `kerb_steps`, `wires` the
    points of `wire_points`, `barriers` the cells of `barrier_cells`, `markings` the stripes of `marking_stripes`,
    `doubts` the clusters of `scene_doubts`.
    """

    labels: CoreLabels
    spans: FileSpans
    counts: LabelCounts
    objects: pd.DataFrame
    fragments: pd.DataFrame
    evidence: pd.DataFrame
    sightings: pd.DataFrame
    sample: PictureSample
    doubts: pd.DataFrame
    kerbs: pd.DataFrame
    wires: pd.DataFrame
    barriers: pd.DataFrame
    markings: pd.DataFrame


def label_new_scene(
    scene: PointCloud,
    bundle: ModelBundle,
    settings: LabelSettings,
    *,
    name: str,
    labeller: Labeller | None = None,
) -> LabelledScene:
    """Label the points of a scene and extract the objects; ground parameters of the model take precedence."""
    scheme = bundle_scheme(bundle)
    scene, ground, soft, kinds = labels_of_model(scene, bundle, settings, labeller=labeller)
    soft = labels_with_given(soft, scene, settings.given, scheme)
    scene, ground, soft = _without_context(scene, ground, soft)
    label, height, core = soft.labels, ground["height"], scene["core"]
    evidence = evidence_of_soft_labels(*soft, scheme=scheme)
    classifier = classifier_of(bundle) if settings.classifier else None
    extracted = _objects(scene, soft, evidence, settings.rules, classifier, height=height, name=name)
    n_classes = len(settings.codes)
    counts = _counts(label[core], soft.confidence[core], n_classes, kinds, contradictions(scene, height))
    of_objects = np.isin(label, [number for rule in settings.rules.values() for number in rule.labels])
    counts["below"] = np.array([(core & of_objects & (height < -MOST_BELOW)).sum()])
    return {
        "labels": _core_labels(scene, soft, extracted.part, n_classes),
        "spans": _spans(scene["file"][core], scene["row"][core]),
        "counts": counts,
        "objects": extracted.objects,
        "fragments": extracted.fragments,
        "evidence": extracted.evidence,
        "sightings": sightings_of_scene(extracted.part, scene, core),
        "sample": scene_sample(scene.xyz, scene.origin, label, core),
        "doubts": scene_doubts(scene, label, height, scheme),
        "kerbs": _kerbs(scene, label, height, scheme, settings.kerbs),
        "wires": wire_points(scene.xyz, height, wire_probability(evidence), core=core, origin=scene.origin),
        "barriers": barrier_cells(
            *(scene.xyz, height, label), scheme=scheme, core=core & inliers(scene), origin=scene.origin
        ),
        "markings": _markings(scene, label, height, scheme, settings.least_contrast),
    }


def labels_of_model(
    scene: PointCloud, bundle: ModelBundle, settings: LabelSettings, *, labeller: Labeller | None = None
) -> tuple[PointCloud, Ground, SoftLabels, NDArray[np.float64] | None]:
    """Return a scene with its given classes, its ground, the labels of a model alone, and the kinds of the scene."""
    trained = bundle.metadata.get("parameters", {}).get("ground")
    scene = with_given(aligned(scene, settings.moves), settings.given, bundle_scheme(bundle))
    ground = ground_of_scene(scene, settings.ground if trained is None else GroundParameters(**trained))
    soft = label_softly(bundle, scene.with_columns(**ground), labeller=labeller)
    kinds = kind_probabilities(bundle, scene)
    return scene, ground, soft._replace(confidence=soft.confidence * np.float32(trust(kinds))), kinds


def scene_doubts(
    scene: PointCloud, label: NDArray[np.integer], height: NDArray[np.float32], scheme: ClassScheme
) -> pd.DataFrame:
    """Return the doubtful clusters that lie mostly in the core of a scene; none where the ground is unknown."""
    known = np.where(np.isfinite(height), label, -1)
    table, owner = doubtful_clusters(Cells(scene.xyz, np.nan_to_num(height), known, scheme.classes))
    own = owner >= 0
    counts = np.bincount(owner[own], minlength=len(table))
    inside = np.bincount(owner[own], weights=scene["core"][own], minlength=len(table))
    kept = table[inside > counts / 2].reset_index(drop=True)
    return kept.assign(**{axis: kept[axis] + scene.origin[k] for k, axis in enumerate("xyz")})


def _core_labels(scene: PointCloud, soft: SoftLabels, part: NDArray[np.int32], n_classes: int) -> CoreLabels:
    """Return the labels of the core; those of outliers and of points without a class have numbers of their own."""
    core = scene["core"]
    label = np.where(soft.labels < 0, n_classes, soft.labels).astype(np.uint8)
    label[~inliers(scene)] = n_classes + 1
    kept = kept_codes(scene)
    labels: CoreLabels = {
        "file": scene["file"][core],
        "row": scene["row"][core],
        "label": label[core],
        "confidence": soft.confidence[core],
        "part": part,
    }
    return labels if kept is None else {**labels, "kept": kept[core]}


def _counts(
    label: NDArray[np.int16],
    confidence: NDArray[np.float32],
    n_classes: int,
    kinds: NDArray[np.float64] | None,
    given: NDArray[np.int64] | None,
) -> LabelCounts:
    counts: LabelCounts = {
        "counts": np.bincount(np.where(label < 0, n_classes, label), minlength=n_classes + 1),
        "confidences": count_confidences(label, confidence, n_classes),
    }
    if kinds is not None:
        counts["kinds"] = kinds
    if given is not None:
        counts["given"] = given
    return counts


def _without_context(scene: PointCloud, ground: Ground, soft: SoftLabels) -> tuple[PointCloud, Ground, SoftLabels]:
    """Return core and buffers of a scene with their ground and labels; the context served the labels alone."""
    if "near" not in scene:
        return scene, ground, soft
    rows = np.flatnonzero(scene["near"])
    owner = None if soft.owner is None else soft.owner[rows]
    labels = SoftLabels(soft.labels[rows], soft.confidence[rows], soft.probabilities, owner)
    return scene.select(rows), {"ground": ground["ground"][rows], "height": ground["height"][rows]}, labels


def _spans(files: NDArray[np.integer], rows: NDArray[np.int64]) -> FileSpans:
    """Return the first and last row of each file; points are ordered by file, and within one by row."""
    starts = np.flatnonzero(np.diff(files, prepend=-1))
    ends = np.append(starts[1:], len(files)) - 1
    return {"spans": np.column_stack([files[starts], rows[starts], rows[ends]]).astype(np.int64)}


def _kerbs(
    scene: PointCloud,
    label: NDArray[np.integer],
    height: NDArray[np.float32],
    scheme: ClassScheme,
    limits: StepLimits | None,
) -> pd.DataFrame:
    if limits is None:
        return no_steps()
    return kerb_steps(
        *(scene.xyz, height, label),
        is_ground=ground_classes(scheme),
        core=scene["core"],
        origin=scene.origin,
        limits=limits,
    )


def _markings(
    scene: PointCloud,
    label: NDArray[np.integer],
    height: NDArray[np.float32],
    scheme: ClassScheme,
    least_contrast: float | None,
) -> pd.DataFrame:
    if least_contrast is None or "intensity" not in scene:
        return no_stripes()
    return marking_stripes(
        *(scene.xyz, height, label, scene["intensity"], scanner_pass_of(scene)),
        is_paved=paved_classes(scheme),
        is_ground=ground_classes(scheme),
        core=scene["core"],
        origin=scene.origin,
        least_contrast=least_contrast,
    )


def _objects(
    scene: PointCloud,
    soft: SoftLabels,
    evidence: ClassEvidence,
    rules: Mapping[str, ObjectRule],
    classifier: ObjectClassifier | None,
    *,
    height: NDArray[np.float32],
    name: str,
) -> SceneObjects:
    known = np.isfinite(height)
    known &= ~(height < -MOST_BELOW) | ~known.any()
    some = known.any() and not known.all()
    return extract_objects(
        scene.xyz,
        np.where(known, soft.labels, np.int16(-1)) if some else soft.labels,
        soft.confidence,
        classes=rules,
        core=scene["core"],
        origin=scene.origin,
        height_above_ground=np.where(known, height, np.float32(0)) if some else height if known.any() else None,
        scene=name,
        evidence=evidence,
        classifier=classifier,
    )


def object_rules(bundle: ModelBundle, changes: Mapping[str, Any]) -> dict[str, ObjectRule]:
    """Return the rules of the candidates for the classes of a model."""
    return candidate_rules(bundle_scheme(bundle), changes)


def label_pieces(
    pieces: Sequence[Mapping[str, NDArray]],
    model: ModelBundle,
    *,
    span: SceneSpan,
    settings: LabelSettings,
    name: str,
    source: str,
) -> LabelledScene:
    """Join the pieces of a scene and label it."""
    scene = join_pieces(pieces, span, settings.outliers, source)
    return label_new_scene(scene, model, settings, name=name)

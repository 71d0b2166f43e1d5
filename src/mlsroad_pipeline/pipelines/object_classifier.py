"""Pipeline that trains the object classifier of the package on simulated streets labelled by the shipped pool."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from kedro.pipeline import Pipeline
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.codings import Coding
from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.stage_parameters import GroundParameters
from mlsroad_pipeline.algorithms.inventory.objects.class_groups import evidence_of_soft_labels
from mlsroad_pipeline.algorithms.inventory.objects.object_classifier import STEM, ObjectClassifier
from mlsroad_pipeline.algorithms.inventory.objects.plates import PLATE
from mlsroad_pipeline.algorithms.inventory.training.candidates import (
    candidates_of_boxes,
    candidates_of_street,
    parts_of_street,
)
from mlsroad_pipeline.algorithms.inventory.training.classifiers import (
    Figures,
    kind_classifiers,
    part_classifier,
    replay_of,
)
from mlsroad_pipeline.algorithms.inventory.training.streets import CLEAN, variant_of_street, variants_of
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle, bundle_scheme
from mlsroad_pipeline.algorithms.models.labelling import label_softly
from mlsroad_pipeline.algorithms.models.pool.labeller import SLUG
from mlsroad_pipeline.algorithms.stages import find_ground
from mlsroad_pipeline.execution.collection import SceneCollection
from mlsroad_pipeline.execution.task import SceneTask, SourceFile
from mlsroad_pipeline.model_store.bundle_files import ModelFile, load_bundle
from mlsroad_pipeline.model_store.object_classifiers import CARD, CLASSIFIER, REPLAY, candidate_replay_arrays
from mlsroad_pipeline.model_store.shipped_entry import ShippedParameters
from mlsroad_pipeline.model_store.shipped_models import FOLDER
from mlsroad_pipeline.pipelines.boosted_trees import load_lightgbm
from mlsroad_pipeline.pipelines.per_scene import named_node
from mlsroad_pipeline.simulation.parameters.presets import expanded_surveys, simulation_parameters
from mlsroad_pipeline.surveys.recordings import TrainingRecording, described_recordings, read_training_scene
from mlsroad_pipeline.surveys.simulated import MOST_POINTS, simulate_street
from mlsroad_pipeline.surveys.truth_tables import points_of_boxes, read_truth

POOL = FOLDER / SLUG


def classifier_streets(shipped: ShippedParameters) -> dict[str, Mapping[str, Any]]:
    """Return the surveys of the streets that are used: two of three."""
    surveys = dict(expanded_surveys(shipped.classifier_streets))
    used = {name: one for k, (name, one) in enumerate(surveys.items()) if one is not None and k % 3 < 2}
    if not used:
        raise ParameterError("shipped.classifier_streets is empty: kedro run --env=general has the streets")
    return used


def label_street(*, points: Mapping[str, NDArray], model: ModelBundle, name: str) -> dict[str, NDArray]:
    """Label a street with a model, and return heights and class probabilities."""
    cloud = PointCloud(points["xyz"], origin=points["origin"], columns={"intensity": points["intensity"]}, source=name)
    if not len(cloud):
        return {"height": np.zeros(0)}
    ground = find_ground(cloud, GroundParameters(**model.metadata["parameters"]["ground"]))
    soft = label_softly(model, cloud.with_columns(**ground))
    evidence = evidence_of_soft_labels(*soft, scheme=bundle_scheme(model))
    return {
        "height": ground["height"], "owner": evidence.owner.astype(np.int32),
        "probabilities": evidence.probabilities.astype(np.float16),
    }  # fmt: skip


def simulate_classifier_streets(shipped: ShippedParameters) -> dict[str, SceneTask]:
    """Create one task per street that simulates it."""
    surveys = classifier_streets(shipped)
    return {k: SceneTask(simulate_street, {}, {"simulation": simulation_parameters(one)}) for k, one in surveys.items()}


def label_classifier_streets(streets: SceneCollection) -> dict[str, SceneTask]:
    """Create one task per street that labels it with the pool of the package."""
    model, points = ModelFile(str(POOL)), streets.part("points")
    return {k: SceneTask(label_street, {"points": points[k], "model": model}, {"name": k}) for k in streets}


def _tasks_of_variants(
    function: Any, shipped: ShippedParameters, streets: SceneCollection, labels: SceneCollection, **more: Any
) -> dict[str, SceneTask]:
    points, objects, scheme = streets.part("points"), streets.part("objects"), bundle_scheme(load_bundle(POOL))
    return {
        key: SceneTask(
            function,
            {"points": points[key], "objects": objects[key], "labels": labels[key]},
            {"name": key, "variants": variants_of(number), "scheme": scheme, **more},
        )
        for number, key in enumerate(classifier_streets(shipped))
    }


def describe_parts(
    shipped: ShippedParameters, streets: SceneCollection, labels: SceneCollection
) -> dict[str, SceneTask]:
    """Create one task per street that describes its upright lines and the pieces that may be plates."""
    return _tasks_of_variants(parts_of_street, shipped, streets, labels)


def find_candidates(
    shipped: ShippedParameters, streets: SceneCollection, labels: SceneCollection, parts: SceneCollection
) -> dict[str, SceneTask]:
    """Train the classifiers of stems and plates, and create one task per street that finds its candidates with them."""
    return _tasks_of_variants(candidates_of_street, shipped, streets, labels, classifier=_train_parts(shipped, parts))


def recorded_candidates(
    path: str, *, coding: Coding, read: Mapping[str, Any], model: ModelBundle, name: str, classifier: ObjectClassifier
) -> dict[str, pd.DataFrame]:
    """Label a scan of a recording with a model, and return its vehicles with what they are by the boxes beside it."""
    cloud = read_training_scene(path, coding=coding, read=read)
    points = {"xyz": cloud.xyz, "origin": cloud.origin, "intensity": cloud["intensity"]}
    labels = label_street(points=points, model=model, name=name)
    none, scheme = np.zeros(len(cloud), np.int32), bundle_scheme(model)
    points |= {"truth": none, "instance": none}
    street = variant_of_street(name, CLEAN, points, pd.DataFrame(), labels, scheme)
    boxes = read_truth(_boxes_beside(Path(path))).objects
    return candidates_of_boxes(street, boxes, points_of_boxes(boxes, cloud.world_xyz()), classifier)


def _boxes_beside(path: Path) -> Path:
    return path.with_name(f"{path.stem}_cuboids.csv")


def find_recorded_candidates(
    shipped: ShippedParameters, classes: Mapping[str, Any], parts: SceneCollection
) -> dict[str, SceneTask]:
    """Create one task per scan of a recording that has boxes of vehicles."""
    model, classifier = ModelFile(str(POOL)), _train_parts(shipped, parts)
    return {
        f"{name}.{stem}": SceneTask(
            recorded_candidates,
            {"path": SourceFile(str(path)), "model": model},
            {
                "coding": recording.read_coding(classes["codings"]), "read": dict(recording.read), "name": name,
                "classifier": classifier,
            },
        )
        for name, recording in TrainingRecording.configured(shipped.recordings).items()
        for stem, path in recording.paths(Path(shipped.root)).items()
        if _boxes_beside(path).is_file()
    }  # fmt: skip


def train_object_classifier(
    shipped: ShippedParameters, parts: SceneCollection, candidates: SceneCollection, recorded: SceneCollection
) -> dict[str, Mapping[str, NDArray] | str]:
    """Train the classifier; return its file, the candidates to replay and its card."""
    names = list(classifier_streets(shipped))
    found, true = candidates.load_all("candidates"), list(candidates.load_all("true").values())
    scans = recorded.load_all("candidates")
    true = pd.concat([*true, *recorded.load_all("true").values()])
    tables = [*(found[name] for name in names), *(scans[name] for name in sorted(scans))]
    table = pd.concat([one for one in tables if len(one)], ignore_index=True)
    n_true = {key: int(number) for key, number in true.groupby(["variant", "kind"])["objects"].sum().items()}
    classifier, figures = kind_classifiers(table, _train_parts(shipped, parts), n_true)
    return {
        CLASSIFIER: classifier.to_arrays(),
        REPLAY: candidate_replay_arrays(replay_of(table)),
        CARD: _card(figures, sum(len(found[name]) > 0 for name in names), sorted(scans), shipped),
    }


def _train_parts(shipped: ShippedParameters, parts: SceneCollection) -> ObjectClassifier:
    load_lightgbm()
    used = [name for name in classifier_streets(shipped)]
    tables = {part: parts.load_all(part) for part in (STEM, PLATE)}
    filled = {part: [found[name] for name in used if len(found[name])] for part, found in tables.items()}
    return part_classifier(*(pd.concat(filled[part], ignore_index=True) for part in (STEM, PLATE)))


def _card(figures: Figures, n_streets: int, scans: list[str], shipped: ShippedParameters) -> str:
    surveys, n_simulated = shipped.classifier_streets.values(), len(classifier_streets(shipped))
    recordings = [
        f"{one['title']} ({one['licence']})" for one in described_recordings(shipped.recordings, scans).values()
    ]
    kinds, presets = (sorted({one for c in surveys for one in c.get(key, ())}) for key in ("streets", "presets"))
    lines = [
        "# Object classifier",
        "",
        "Boosted trees that score the objects of an inventory and separate trunks from poles, and plates from other",
        "surfaces. MIT licence.",
        f"Trained on {n_streets} simulated streets of {len(kinds)} kinds (of {n_simulated}: those with at most",
        f"{MOST_POINTS:,} points), labelled by the shipped model `{SLUG}`, which was not trained on them.",
        "Each street was used three times: as labelled, and twice with noise in its class probabilities, sheared, with",
        "leaning poles, and with some poles labelled tree and some trunks labelled pole. Vehicles were also trained on",
        "in each street with gaps that cut them. Moving vehicles are true objects here,",
        "although most are stretched by their motion and cannot be found whole.",
        f"Vehicles were trained on in scans with boxes, too: {', '.join(recordings) or 'none'}.",
        f"Seeds {', '.join(str(c.get('seed', 0)) for c in surveys)}; scanners",
        f"{', '.join(presets)}.",
        "",
        "Candidates of streets that the trees were not trained on (five folds of streets):",
        "",
        "| streets | kind | true | candidates | precision at 0.4 | recall at 0.4 | F at 0.4 | calibration error |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for group, rows in figures.items():
        for kind, row in rows.items():
            names = ("precision_at_0.4", "recall_at_0.4", "f_at_0.4", "calibration_error")
            shown = [f"{row['true_objects']:.0f}", f"{row['candidates']:.0f}", *(f"{row[name]:.2f}" for name in names)]
            lines.append(f"| {group} | {kind} | {' | '.join(shown)} |")
    return "\n".join([*lines, "", f"Made by `{shipped.command()} --pipelines=object_classifier`.", ""])


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline: parameters to the files of the object classifier."""
    own = {name: f".{name}" for name in ("streets", "labels", "parts", "candidates", "recorded")} | {
        "slug": "object_classifier"
    }
    return Pipeline(
        [
            named_node(simulate_classifier_streets, ".streets", **own),
            named_node(label_classifier_streets, ".labels", **own),
            named_node(describe_parts, ".parts", "describe_classifier_parts", **own),
            named_node(find_candidates, ".candidates", "find_classifier_candidates", **own),
            named_node(find_recorded_candidates, ".recorded", "find_recorded_vehicles", **own),
            named_node(train_object_classifier, "shipped_object_classifier", **own),
        ]
    )

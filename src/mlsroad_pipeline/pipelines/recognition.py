"""Recognition of objects from scenes, and scores of all recognisers."""

from collections.abc import Mapping
from typing import Any

import pandas as pd
from kedro.pipeline import Node, Pipeline
from matplotlib.figure import Figure

from mlsroad_pipeline.algorithms.models.methods import methods_of
from mlsroad_pipeline.execution.collection import SceneCollection
from mlsroad_pipeline.execution.task import SceneTask, SourceFile
from mlsroad_pipeline.papers.shared.recognition.cutting import RecognitionParameters, cut_objects
from mlsroad_pipeline.papers.shared.recognition.object_set import find_folds, listed_files, read_fold
from mlsroad_pipeline.papers.shared.recognition.recogniser import score_recognitions
from mlsroad_pipeline.pipelines.compare import compare_methods
from mlsroad_pipeline.pipelines.per_scene import fix_arguments, named_node, scene_node
from mlsroad_pipeline.pipelines.recognisers import create_pipeline as recogniser_pipeline
from mlsroad_pipeline.pipelines.schemes import recognition_scheme
from mlsroad_pipeline.reporting.figures import confusion_figure
from mlsroad_pipeline.surveys.parameters import SurveyParameters


def read_object_folds(
    survey: SurveyParameters, recognition: RecognitionParameters, classes: Mapping[str, Any]
) -> dict[str, SceneTask]:
    """Create one task per fold that reads its objects."""
    survey.check_root()
    scheme = recognition_scheme(recognition, classes)
    return {
        name: SceneTask(
            read_fold,
            {"path": SourceFile(str(path)), "files": [SourceFile(str(file)) for file in listed_files(path)]},
            {"scheme": scheme},
        )
        for name, path in find_folds(survey.root, str(recognition.folds)).items()
    }


def score_recogniser(
    sets: SceneCollection,
    recognitions: SceneCollection,
    recognition: RecognitionParameters,
    classes: Mapping[str, Any],
    *,
    method: str,
) -> tuple[pd.DataFrame, Figure]:
    """Score a method on the objects that it was not trained on."""
    truth = {key: sets[key].load()["label"] for key in recognitions}
    scheme = recognition_scheme(recognition, classes)
    scores, matrices = score_recognitions(
        truth,
        {key: found["label"] for key, found in recognitions.load_all().items()},
        method=method,
        scheme=scheme,
        folds=recognition.folds is not None,
    )
    last = list(matrices)[-1]
    return scores, confusion_figure(matrices[last], classes=scheme.classes, title=f"{method}, split {last}")


def train_recognisers() -> Pipeline:
    """Return the pipelines of all recognisers."""
    return sum((recogniser_pipeline(slug) for slug in methods_of("recognition")), Pipeline([]))


def score_recognisers() -> Pipeline:
    """Return the pipeline that scores all recognisers and compares them in a table."""
    scores = [
        named_node(
            fix_arguments(score_recogniser, method=slug), [".scores", ".confusion_figure"], f"score_{slug}",
            slug=slug, sets="object_sets", recognitions=".recognitions",
        )
        for slug in methods_of("recognition")
    ]  # fmt: skip
    compared = Node(
        compare_methods,
        [f"{slug}.scores" for slug in methods_of("recognition")],
        "recognition_comparison",
        name="compare_recognisers",
    )
    return Pipeline([*scores, compared])


def read_folds() -> Pipeline:
    """Return the pipeline that reads objects from files: the survey's root to ``object_sets``."""
    return Pipeline([named_node(read_object_folds, "object_sets")])


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline: scenes and their objects to sets of objects, and these to the scores of all recognisers."""
    own = {"parameters": "params:recognition"}
    cut = scene_node(cut_objects, "object_sets", "cut_objects_of_scenes", inputs=own, scheme=recognition_scheme)
    return Pipeline([cut]) + train_recognisers() + score_recognisers()

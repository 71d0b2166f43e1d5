"""Objects from files, and scores of recognisers."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pandas as pd
from matplotlib.figure import Figure

from mlsroad_pipeline.execution.collection import SceneCollection
from mlsroad_pipeline.execution.task import SceneTask, SourceFile
from mlsroad_pipeline.papers.shared.recognition.cutting import RecognitionParameters
from mlsroad_pipeline.papers.shared.recognition.object_files import find_folds, listed_files, read_fold
from mlsroad_pipeline.papers.shared.recognition.scores import score_recognitions
from mlsroad_pipeline.pipelines.schemes import recognition_scheme
from mlsroad_pipeline.reporting.figures.scores import confusion_figure
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

"""Figures of a trained forest."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from mlsroad_pipeline.papers.tomic2019.detrended_forest.classifier import DetrendedForestClassifier
from mlsroad_pipeline.reporting.figures import importance_figure, oob_figure


def forest_figures(classifier: DetrendedForestClassifier) -> tuple[Figure, Figure]:
    """Draw the feature importances and the out-of-bag error of a forest."""
    importances = classifier.feature_importances_
    curve = classifier.oob_error_curve_
    return (
        importance_figure(list(importances.values()), names=list(importances), title="Feature importances"),
        oob_figure(np.arange(1, len(curve) + 1), curve, chosen=len(curve), title="Out-of-bag error"),
    )

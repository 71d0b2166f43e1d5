"""Corrections of a labelled survey: store, import from edited files, order of review, learning."""

from mlsroad_pipeline.review.corrections.decisions import ACTIONS, Correction, Decision
from mlsroad_pipeline.review.corrections.states import review_order
from mlsroad_pipeline.review.corrections.store import CorrectionStore, has_corrections, open_corrections

__all__ = [
    "ACTIONS",
    "Correction",
    "CorrectionStore",
    "Decision",
    "has_corrections",
    "open_corrections",
    "review_order",
]

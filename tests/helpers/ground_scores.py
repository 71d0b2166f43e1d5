"""Scores of predicted ground points, counted and summarised in one call."""

from mlsroad_pipeline.algorithms.metrics.ground import count_ground, scores_of_counts


def score_ground(is_ground, reference, *, valid=None):
    """Return the scores of predicted ground points against a reference."""
    return scores_of_counts(count_ground(is_ground, reference, valid=valid))

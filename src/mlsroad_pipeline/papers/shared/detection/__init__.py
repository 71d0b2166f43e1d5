"""Detection of objects: descriptions, training, thresholds and scoring."""

"""Scores of labels, segmentations, detections and ground filters from counts."""

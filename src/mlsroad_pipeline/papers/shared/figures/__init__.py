"""Figures of detections and labels."""

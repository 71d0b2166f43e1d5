"""Segmentation of off-ground points into objects."""

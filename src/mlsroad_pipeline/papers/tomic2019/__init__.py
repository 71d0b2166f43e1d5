"""Tomic et al. 2019: detrended forest, labels from images, their fusion and the study."""

"""Baseline of Luo et al. 2019: spin images with an SVM."""

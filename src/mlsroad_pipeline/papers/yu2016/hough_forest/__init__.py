"""Baseline of Yu et al. 2016: Hough forest."""

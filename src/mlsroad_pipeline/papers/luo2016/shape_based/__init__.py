"""Baseline of Luo et al. 2016: shape-based recognition (Golovinskiy et al. 2009)."""

"""Baseline of Yu et al. 2016: objects matched to prototypes."""

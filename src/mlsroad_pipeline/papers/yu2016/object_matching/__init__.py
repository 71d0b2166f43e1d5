"""Baseline of Yu et al. 2016: matching of objects with prototypes."""

"""Baseline of Yu et al. 2016: spin images and extended Gaussian images."""

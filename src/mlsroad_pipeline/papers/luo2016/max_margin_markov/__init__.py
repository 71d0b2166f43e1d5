"""Baseline of Luo et al. 2016: max-margin Markov network."""

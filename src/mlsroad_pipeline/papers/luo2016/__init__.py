"""Luo et al. 2016: patch-match graph, Markov random field, their baselines and the study."""

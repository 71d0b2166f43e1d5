"""3-D patch match graph and its refinement by a Markov random field (Luo et al. 2016, sections III-B to III-D)."""

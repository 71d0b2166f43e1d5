"""Study of Luo et al. 2016: patch match graph and Markov random field."""

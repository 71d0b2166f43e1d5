"""Yu et al. 2016: bags of contextual visual words, their baselines and the study."""

"""Luo et al. 2019: JointNet, its baselines and the study."""

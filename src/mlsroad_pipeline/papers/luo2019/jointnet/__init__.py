"""JointNet: objects recognised by fused accumulation images (Luo et al. 2019)."""

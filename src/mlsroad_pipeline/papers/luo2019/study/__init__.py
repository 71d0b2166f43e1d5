"""Study of Luo et al. 2019: recognition of objects by JointNet."""

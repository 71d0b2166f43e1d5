"""Detection of objects by bags of contextual visual words (Yu et al. 2016)."""

"""Training of the object classifier on simulated streets."""

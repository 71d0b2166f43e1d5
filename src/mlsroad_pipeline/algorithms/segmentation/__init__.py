"""Off-ground points cut into objects."""

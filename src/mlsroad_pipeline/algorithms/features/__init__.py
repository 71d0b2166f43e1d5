"""Per-point and per-supervoxel descriptors."""

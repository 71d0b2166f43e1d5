"""Features of points, supervoxels and objects."""

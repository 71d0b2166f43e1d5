"""Pictures of point clouds by splatting."""

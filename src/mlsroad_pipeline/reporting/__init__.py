"""Pictures of point clouds and of scores."""

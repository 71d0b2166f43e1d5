"""Geometry and materials of the simulated street: meshes, solids, batches."""

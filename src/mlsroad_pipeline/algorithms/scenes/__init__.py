"""Scenes of a survey: trajectory, corridor, tiling, cutting and splits."""

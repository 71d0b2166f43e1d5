"""Cameras: calibration, poses, projection, legends of label images."""

"""Surveys as input: discovery of files, splits, scene plans, reading and images."""

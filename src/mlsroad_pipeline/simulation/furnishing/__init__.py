"""Placement of objects along the street."""

"""Scores of objects, lines and measures against a reference."""

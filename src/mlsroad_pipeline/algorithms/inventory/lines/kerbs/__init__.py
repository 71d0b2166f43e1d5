"""Kerbs: steps in the ground beside the carriageway, as lines."""

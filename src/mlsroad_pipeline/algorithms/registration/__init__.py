"""Offsets between recordings of one place: passes, files, surveys."""

"""Figures of merit, all from plain counts."""

"""Slow, obvious re-implementations, compared with the fast code."""

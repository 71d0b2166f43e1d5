"""Designs of street objects, one family per module."""

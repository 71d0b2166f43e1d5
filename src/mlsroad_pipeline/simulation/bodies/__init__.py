"""Articulated bodies of people and animals."""

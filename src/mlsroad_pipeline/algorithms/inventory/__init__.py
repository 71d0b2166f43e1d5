"""Inventory of road objects and lines, and its scores."""

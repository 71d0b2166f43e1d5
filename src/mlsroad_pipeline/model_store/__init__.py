"""Shipped and registered models."""

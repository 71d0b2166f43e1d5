"""Simulated photographs and point colours."""

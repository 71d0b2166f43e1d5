"""Matplotlib figures of scores, training and surveys."""

"""Fusion of the labels of several labellers."""

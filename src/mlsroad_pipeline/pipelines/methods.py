"""The methods that there are; a new one is one line here."""

LABELLERS = ("detrended_forest", "patch_svm", "patch_forest", "max_margin_markov", "shape_based")
"""Slugs of the methods that label points; each has a pipeline of its name that writes ``<slug>.model`` and
``<slug>.labels``."""

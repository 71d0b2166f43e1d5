"""Figures of point clouds and scores, and HTML reports."""

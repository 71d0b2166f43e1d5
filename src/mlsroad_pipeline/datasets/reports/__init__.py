"""Kedro datasets of reports, figures and scores."""

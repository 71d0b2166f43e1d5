"""Baselines of the papers, one package each."""

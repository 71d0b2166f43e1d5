"""Reproductions of four papers, with the baselines that each compared with."""

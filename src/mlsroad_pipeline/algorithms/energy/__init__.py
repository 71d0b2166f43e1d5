"""Discrete energies over graphs and their minimisation by graph cuts."""

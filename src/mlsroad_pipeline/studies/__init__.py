"""Experiments of the papers: parameters, plans, worker functions, tables, figures and reports."""

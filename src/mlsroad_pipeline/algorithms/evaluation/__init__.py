"""Evaluation of labels against a reference."""

"""Superpoint transformer (Robert, Raguet and Landrieu 2023): attention over a hierarchy of superpoints."""

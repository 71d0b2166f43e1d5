"""Registers of objects against an inventory and what the scanner has seen."""

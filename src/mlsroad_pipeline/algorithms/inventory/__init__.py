"""Inventory of road objects: from labelled points to the measured objects of a survey."""

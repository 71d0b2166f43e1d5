"""The inventory of road objects: from labelled points to measured objects of a whole survey."""

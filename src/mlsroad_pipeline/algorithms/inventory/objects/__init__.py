"""Poles, signs, vehicles and trees from labelled points."""

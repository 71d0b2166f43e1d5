"""Kerbs, wires and road markings from labelled points."""

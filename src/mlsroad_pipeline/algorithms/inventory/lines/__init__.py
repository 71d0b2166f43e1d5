"""Kerbs, wires, barriers and road markings from labelled points."""

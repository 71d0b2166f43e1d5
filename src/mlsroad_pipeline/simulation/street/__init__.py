"""The street itself: alignment, ground, markings, junctions, the drive."""

"""Supervoxels: small, compact, connected pieces of a cloud that do not cross object borders."""

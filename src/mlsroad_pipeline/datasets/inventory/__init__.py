"""Kedro datasets of the road inventory: GeoPackage and GeoParquet."""

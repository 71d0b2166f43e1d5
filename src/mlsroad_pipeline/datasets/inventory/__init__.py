"""Kedro dataset of the road inventory, with its formats GeoPackage and GeoParquet."""

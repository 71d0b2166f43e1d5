"""Writers and readers of inventories: GeoPackage, GeoParquet, vector and CAD files, QGIS styles."""

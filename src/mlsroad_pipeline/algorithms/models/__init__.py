"""Models of the product, model bundles and the table of methods."""

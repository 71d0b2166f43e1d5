"""Point clouds, classes, errors and validation."""

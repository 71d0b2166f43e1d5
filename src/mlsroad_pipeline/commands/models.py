"""Command `mlsroad models`."""


def models() -> None:
    """List the models."""

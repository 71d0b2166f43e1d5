"""A method of a test in the table of methods."""

from mlsroad_pipeline.algorithms.models.methods import METHODS, PACKAGE, Method


def plant_method(monkeypatch, slug, label_cloud):
    """Add a method whose function ``module:name`` below `PACKAGE` labels clouds."""
    monkeypatch.setitem(
        METHODS, slug, Method(slug, "labelling", "", label_cloud=label_cloud.removeprefix(f"{PACKAGE}."))
    )

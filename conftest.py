"""Namespace of the doctests."""

import pytest


@pytest.fixture(autouse=True)
def _doctest_folder(request, doctest_namespace, tmp_path_factory):
    """Provide a temporary folder `tmp_path` for examples that write files."""
    if request.node.__class__.__name__ == "DoctestItem":
        doctest_namespace["tmp_path"] = tmp_path_factory.mktemp("doctest")

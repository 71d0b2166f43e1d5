"""What the doctests in docstrings find in their namespace."""

import pytest


@pytest.fixture(autouse=True)
def _doctest_folder(request, doctest_namespace, tmp_path_factory):
    """Give examples that write files a folder of their own."""
    if request.node.__class__.__name__ == "DoctestItem":
        doctest_namespace["tmp_path"] = tmp_path_factory.mktemp("doctest")

"""What tests of stored scenes share."""

import pytest
from references_store import store_at


@pytest.fixture
def marks(tmp_path):
    folder = tmp_path / "marks"
    folder.mkdir()
    return folder


@pytest.fixture
def store(tmp_path):
    return store_at(tmp_path / "stage")

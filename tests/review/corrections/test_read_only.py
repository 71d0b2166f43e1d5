"""Output folders that cannot be written: decisions are read, the cache of the page lies elsewhere, nothing is created."""

import os
from pathlib import Path

import pytest
from helpers.corrected import object_rows, write_inventory

from mlsroad_pipeline.algorithms.core.exceptions import ReadError
from mlsroad_pipeline.review.corrections import Correction, open_corrections
from mlsroad_pipeline.review.page_server.tile_cache import CACHE, cache_of


@pytest.fixture
def folder(tmp_path):
    write_inventory(tmp_path, object_rows())
    return tmp_path


def forbid_writing(monkeypatch, folder):
    """Let `os.access` answer as for a user without the right to write; tests may run as root, who has it."""
    real = os.access
    inside = str(folder)

    def access(path, mode, **more):
        return not (mode & os.W_OK and str(path).startswith(inside)) and real(path, mode, **more)

    monkeypatch.setattr(os, "access", access)


def test_a_folder_without_decisions_is_opened_and_stays_as_it_is(folder, monkeypatch):
    before = sorted(path.name for path in folder.rglob("*"))
    forbid_writing(monkeypatch, folder)
    with open_corrections(folder, write=False) as store:
        assert store.history() == [] and store.object_states() == {}
        assert store.mark() == "0-0"
        with pytest.raises(ReadError, match=r"corrections.sqlite cannot be written: change its permissions"):
            store.add(Correction("accept", 1), who="ann")
    assert sorted(path.name for path in folder.rglob("*")) == before


def test_decisions_are_read_and_none_can_be_added(folder, monkeypatch):
    with open_corrections(folder) as store:
        store.add(Correction("accept", 1), who="ann")
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    forbid_writing(monkeypatch, folder)
    with open_corrections(folder, write=False) as store:
        assert [decision.who for decision in store.history()] == ["ann"]
        with pytest.raises(ReadError, match="cannot be written"):
            store.undo(1, who="bob")
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before


def test_writing_is_refused_at_once(folder, monkeypatch):
    forbid_writing(monkeypatch, folder)
    with pytest.raises(ReadError, match="cannot be written"):
        open_corrections(folder)


def test_the_cache_of_the_page_lies_in_a_temporary_folder(folder, monkeypatch):
    assert cache_of(folder) == folder / CACHE
    cache_of.cache_clear()
    forbid_writing(monkeypatch, folder)
    place = cache_of(folder)
    assert place.is_dir() and not place.is_relative_to(folder)
    assert cache_of(Path(folder)) == place
    assert not (folder / CACHE).exists()
    cache_of.cache_clear()

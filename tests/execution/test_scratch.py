"""Folder of this process for temporary files."""

import shutil
import tempfile

from mlsroad_pipeline.execution.scratch import PREFIX, _folder_of, scratch_folder


def test_a_folder_that_a_cleaner_removed_is_made_again(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    _folder_of.cache_clear()  # an earlier test of this process may have made one elsewhere
    try:
        first = scratch_folder()
        assert scratch_folder() == first and first.name.startswith(PREFIX)
        shutil.rmtree(first)
        assert scratch_folder().is_dir() and scratch_folder().parent == tmp_path
    finally:
        _folder_of.cache_clear()

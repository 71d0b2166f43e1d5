"""Place of the compiled kernels where neither the package nor the cache of the user can be written."""

import os
import tempfile

import pytest

import mlsroad_pipeline
from mlsroad_pipeline.commands.options import login_name
from mlsroad_pipeline.commands.session import compiled_kernels


@pytest.fixture
def nowhere(monkeypatch, tmp_path):
    """A user without a home, whose folders cannot be written but for the temporary one."""
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setenv("HOME", "/nonexistent")
    monkeypatch.setattr(os, "access", lambda path, mode: str(path).startswith(str(tmp_path)))
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    yield tmp_path
    os.environ.pop("NUMBA_CACHE_DIR", None)


def test_kernels_go_into_a_folder_of_the_user_alone(nowhere):
    assert mlsroad_pipeline._place_kernels()
    folder = nowhere / f"mlsroad-kernels-{os.geteuid()}"
    assert os.environ["NUMBA_CACHE_DIR"] == str(folder) and folder.stat().st_mode & 0o777 == 0o700
    assert not compiled_kernels()
    (folder / "part").mkdir()
    (folder / "part" / "a.nbi").touch()
    assert compiled_kernels() and not mlsroad_pipeline._place_kernels()
    del os.environ["NUMBA_CACHE_DIR"]
    assert mlsroad_pipeline._place_kernels() and os.environ["NUMBA_CACHE_DIR"] == str(folder)


@pytest.mark.parametrize("kind", ["link", "open", "file"])
def test_a_folder_that_others_can_write_is_not_taken(nowhere, tmp_path_factory, kind):
    folder, other = nowhere / f"mlsroad-kernels-{os.geteuid()}", tmp_path_factory.mktemp("other")
    if kind == "link":
        folder.symlink_to(other)
    elif kind == "open":
        folder.mkdir()
        folder.chmod(0o777)
    else:
        folder.touch()
    assert mlsroad_pipeline._place_kernels()
    chosen = os.environ["NUMBA_CACHE_DIR"]
    assert (
        chosen != str(folder) and os.path.dirname(chosen) == str(nowhere) and os.stat(chosen).st_mode & 0o777 == 0o700
    )


@pytest.mark.parametrize("variable", ["NUMBA_CACHE_DIR", "XDG_CACHE_HOME"])
def test_a_given_place_is_kept(nowhere, monkeypatch, variable):
    monkeypatch.setenv(variable, str(nowhere / "given"))
    assert not mlsroad_pipeline._place_kernels()


def test_a_user_number_without_a_name_is_unknown(monkeypatch):
    def none():
        raise KeyError("getpwuid(): uid not found: 54321")

    monkeypatch.setattr("getpass.getuser", none)
    assert login_name() == "unknown"

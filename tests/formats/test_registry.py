"""Choice of the format of a file, and the message where there is none."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from helpers.formats import make_las

from mlsroad_pipeline.algorithms.core.exceptions import ReadError
from mlsroad_pipeline.formats import files
from mlsroad_pipeline.formats.files import atomic_file
from mlsroad_pipeline.formats.registry import format_of_name, get_format, known_extensions


def test_by_name_and_content(tmp_path, rng):
    las = tmp_path / "a.LAZ"
    make_las(tmp_path / "a.laz", rng)
    (tmp_path / "a.laz").rename(las)
    text, ply, scan = tmp_path / "b.xyz_label_conf", tmp_path / "c.ply", tmp_path / "d.bin"
    text.write_text("1 2 3 4 5\n")
    ply.write_text("ply\nformat ascii 1.0\nelement vertex 0\nend_header\n")
    scan.write_bytes(np.zeros(4, "<f4").tobytes())
    assert [get_format(p).name for p in (las, text, ply, scan)] == ["LAS", "text", "PLY", "KITTI"]
    assert get_format(las.rename(tmp_path / "no_extension")).name == "LAS"
    (tmp_path / "points.dat").write_text("# a street\nx;y;z;name\n1,5;2;3;a\n4;5;6;b\n")
    assert get_format(tmp_path / "points.dat").name == "text"
    assert format_of_name("x/Y.CSV.GZ").name == "text"
    assert format_of_name("x.dwg") is None
    assert {".las", ".laz", ".ply", ".txt.gz", ".bin"} <= set(known_extensions())


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.las", b"ply\nformat ascii 1.0\n", r"a\.las is named as LAS, but holds PLY"),
        ("a.ply", b"LASF" + b"\0" * 300, r"a\.ply is named as PLY, but holds LAS"),
        ("a.txt", b"LASF" + b"\0" * 300, r"a\.txt is named as text, but holds LAS"),
        ("a.laz", b"1 2 3\n4 5 6\n", r"a\.laz is named as LAS, but holds something that begins with b'1 2 3"),
        ("a.csv", b"\x1f\x8b\x08\x00", r"a\.csv is named as text, but holds gzip"),
        ("a.bin", b"# .PCD v0.7\n", r"a\.bin is named as KITTI, but holds PCD"),
        ("a.dat", b"one two three\n", r"a\.dat is of no known format: .*known extensions: .*\.laz"),
        ("a.las", b"", r"a\.las is empty \(0 bytes\)"),
    ],
)
def test_wrong_names(tmp_path, name, content, message):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(ReadError, match=message):
        get_format(tmp_path / name)


def test_missing_folder_unreadable(tmp_path):
    with pytest.raises(ReadError, match=r"none\.las does not exist"):
        get_format(tmp_path / "none.las")
    with pytest.raises(ReadError, match=r"is a folder, not a file"):
        get_format(tmp_path)
    locked = tmp_path / "locked.las"
    locked.write_bytes(b"LASF")
    locked.chmod(0)
    if os.access(locked, os.R_OK):
        pytest.skip("this user may read everything")
    with pytest.raises(ReadError, match=r"locked\.las .*Permission"):
        get_format(locked)


def test_denied_by_the_system(tmp_path, monkeypatch):
    path = tmp_path / "locked.las"
    path.write_bytes(b"LASF")

    def denied(self, *args, **kwargs):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(type(path), "open", denied)
    with pytest.raises(ReadError, match=r"locked\.las .*Permission"):
        get_format(path)


def test_atomic_file_leaves_nothing_of_a_failure(tmp_path):
    target = tmp_path / "deep" / "a.las"
    with pytest.raises(RuntimeError, match="half way"), atomic_file(target) as stream:
        stream.write(b"half")
        raise RuntimeError("half way")
    assert list(target.parent.iterdir()) == []
    with atomic_file(target) as stream:
        stream.write(b"whole")
        assert not target.exists()
    assert target.read_bytes() == b"whole"


def test_atomic_file_removes_the_part_of_a_killed_process_and_not_that_of_a_living_one(tmp_path):
    target = tmp_path / "s[1].laz"
    script = (
        "import os, sys, pathlib; from mlsroad_pipeline.formats.files import atomic_file\n"
        "with atomic_file(pathlib.Path(sys.argv[1])) as stream:\n    os.kill(os.getpid(), 9)"
    )
    subprocess.run([sys.executable, "-c", script, str(target)], check=False)
    (killed,) = tmp_path.iterdir()
    with atomic_file(target) as stream:
        assert not killed.exists()
        (mine,) = tmp_path.iterdir()
        with atomic_file(target) as other:  # of another process, or of another container with the same process number
            other.write(b"second")
        assert mine.exists()
        stream.write(b"first")
    assert [path.name for path in tmp_path.iterdir()] == [target.name]
    assert target.read_bytes() == b"first"


def test_a_part_that_is_removed_before_it_is_locked_is_made_again(tmp_path, monkeypatch):
    lock, seen = files._lock, []

    def removed_by_another(stream):
        if not seen:
            Path(stream.name).unlink()  # another process takes it for the part of a killed one
        seen.append(Path(stream.name))
        return lock(stream)

    monkeypatch.setattr(files, "_lock", removed_by_another)
    with atomic_file(tmp_path / "a.las") as stream:
        stream.write(b"whole")
    assert len(set(seen)) == 2
    assert [path.name for path in tmp_path.iterdir()] == ["a.las"]
    assert (tmp_path / "a.las").read_bytes() == b"whole"

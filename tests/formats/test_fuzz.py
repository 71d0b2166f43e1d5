"""Damaged files of every format family: a clear error that names the file, or points; never a crash, never a hang.

``MLSROAD_FUZZ=1000`` sets the number of mutated files per family; the suite runs a sample of them.
"""

import gzip
import logging
import os
import resource
import signal
import struct
from pathlib import Path

import numpy as np
import pytest
from helpers.formats import make_las
from helpers.mutations import mutated

from mlsroad_pipeline.algorithms.core.exceptions import MlsRoadError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.formats.base import ReadOptions, WriteOptions
from mlsroad_pipeline.formats.registry import format_of_name, get_format
from mlsroad_pipeline.formats.sydney import SydneyFormat

N_CASES = int(os.environ.get("MLSROAD_FUZZ", "75"))
SECONDS = 20
MEMORY = 2 << 30
NAMES = {
    **{
        "las": "a.las",
        "laz": "a.laz",
        "copc": "a.copc.laz",
        "ply": "a.ply",
        "ascii_ply": "b.ply",
        "pcd": "a.pcd",
        "packed_pcd": "b.pcd",
    },
    **{"e57": "a.e57", "text": "a.csv", "gzip": "a.txt.gz", "kitti": "a.bin", "sydney": "tree.0.1.bin"},
    **{"parquet": "a.parquet", "npz": "a.npz"},
    **{"packed_ply": "a.ply.gz", "packed_binary_pcd": "a.pcd.gz", "packed_las": "a.las.gz", "packed_e57": "a.e57.gz"},
}


def make_cloud(rng, n=400):
    columns = {
        **{"rgb": rng.integers(0, 256, (n, 3), dtype=np.uint8), "intensity": rng.random(n).astype(np.float32)},
        **{"gps_time": rng.random(n) * 1e6, "label": rng.integers(0, 20, n, dtype=np.int32)},
    }
    return PointCloud(rng.normal(size=(n, 3)) * 30, columns)


def make_seed(family, path, rng):
    """Write a sound file of a family."""
    cloud = make_cloud(rng)
    if family in ("packed_las", "packed_e57"):
        plain = path.with_suffix("")
        make_seed(family.removeprefix("packed_"), plain, rng)
        path.write_bytes(gzip.compress(plain.read_bytes()))
    elif family in ("las", "laz"):
        make_las(path, rng, geotiff=25832)
    elif family == "ascii_ply":
        rows = "\n".join(" ".join(map(str, row)) for row in cloud.xyz.tolist())
        properties = "property float x\nproperty float y\nproperty float z\n"
        path.write_text(f"ply\nformat ascii 1.0\nelement vertex 400\n{properties}end_header\n{rows}\n")
    elif family == "packed_pcd":
        data = cloud.xyz.astype("<f4").T.tobytes()
        packed = b"".join(bytes([len(data[i : i + 32]) - 1]) + data[i : i + 32] for i in range(0, len(data), 32))
        head = "# .PCD v0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH 400\nHEIGHT 1\nDATA binary_compressed\n"
        path.write_bytes(head.encode() + struct.pack("<II", len(packed), len(data)) + packed)
    elif family == "sydney":
        columns = {
            **{"gps_time": 1.32e9 + np.arange(400.0), "intensity": cloud["intensity"], "id": np.zeros(400, np.uint8)},
            **{"azimuth": np.zeros(400, np.float32), "range": np.linalg.norm(cloud.xyz, axis=1).astype(np.float32)},
            "pid": np.arange(400, dtype=np.int32),
        }
        SydneyFormat().write(path, PointCloud(cloud.xyz, columns), WriteOptions())
    else:
        if family == "kitti":
            cloud = cloud.without_columns(["rgb", "gps_time"])
        format_of_name(path).write(path, cloud, WriteOptions(delimiter=","))


class _Hang(Exception):
    pass


def _alarm(*_):
    raise _Hang


def read_all(path):
    """Read a file as a survey is read: described, then by ranges."""
    form = get_format(path)
    info = form.info(path, ReadOptions())
    for start in range(0, min(info.n_points, 5_000), 1_000):
        form.read(path, ReadOptions(), start=start, stop=start + 1_000)
    return info.n_points


@pytest.mark.parametrize("family", NAMES)
def test_damaged_files(tmp_path, rng, family):
    seed = tmp_path / "sound" / NAMES[family]
    seed.parent.mkdir()
    make_seed(family, seed, rng)
    assert read_all(seed) > 0
    sound = seed.read_bytes()
    limits = resource.getrlimit(resource.RLIMIT_AS)
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    before = signal.signal(signal.SIGPROF, _alarm)
    resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY, limits[1]))  # what asks for more fails with MemoryError
    outcomes = {"refused": 0, "read": 0}
    try:
        for case in range(N_CASES):
            case_rng = np.random.default_rng([case, len(family)])
            if NAMES[family].endswith(".gz") and case % 2:  # what is packed, not the packing
                content = gzip.compress(mutated(gzip.decompress(sound), case_rng))
            else:
                content = mutated(sound, case_rng)
            path = tmp_path / str(case) / NAMES[family]
            path.parent.mkdir()
            path.write_bytes(content)
            signal.setitimer(signal.ITIMER_PROF, SECONDS)  # of processor time: a stopped process does not hang
            try:
                read_all(path)
                outcomes["read"] += 1
            except MlsRoadError as error:
                assert path.name in str(error), f"case {case}: {error}"
                outcomes["refused"] += 1
            except Exception as error:
                raise AssertionError(f"{family}, case {case}: {type(error).__name__}: {error}") from error
            finally:
                signal.setitimer(signal.ITIMER_PROF, 0)
                path.unlink()
    finally:
        resource.setrlimit(resource.RLIMIT_AS, limits)
        signal.signal(signal.SIGPROF, before)
    logging.getLogger(__name__).info("%s: %s", family, outcomes)
    assert outcomes["refused"] > N_CASES // 10  # the damage is damage

"""Speed and memory of reading and writing surveys, compared with laspy, lazrs, NumPy, pypcd4 and pye57.

    python benchmarks/bench_formats.py [LAZ] [--only GROUP ...]

Without a file the street of 5 million points of `$MLSROAD_RIVALS` is used, without groups all of them. Elapsed and
processor time of this process, medians of three runs.
"""

from __future__ import annotations

import json
import os
import resource
import tempfile
from collections.abc import Callable
from pathlib import Path

import laspy
import lazrs
import numpy as np
import pye57
import pypcd4
from _common import RIVALS, parser, race, show

from mlsroad_pipeline.formats.base import ReadOptions, WriteOptions
from mlsroad_pipeline.formats.e57.format import CARTESIAN
from mlsroad_pipeline.formats.e57.format import _open as open_e57
from mlsroad_pipeline.formats.las.format import LasFormat
from mlsroad_pipeline.formats.las.header import LASZIP, RECORD_SIZES, LasHeader, read_header
from mlsroad_pipeline.formats.las.records import RecordReader
from mlsroad_pipeline.formats.las.writer import RecordWriter
from mlsroad_pipeline.formats.pcd.format import _open as open_pcd
from mlsroad_pipeline.formats.ply.format import PlyFormat
from mlsroad_pipeline.formats.registry import get_format
from mlsroad_pipeline.formats.text.format import TextFormat
from mlsroad_pipeline.label.writer import write_labelled
from mlsroad_pipeline.surveys.inspection import inspect_file

CHUNK = 1_000_000
REPEATS = 3
OTHERS = ("lazrs alone", "laspy", "numpy.loadtxt", "pypcd4 as one array", "pypcd4", "pye57")
"""Suffix of the names of competing programs."""
TABLE_POINTS, TEXT_POINTS = 1_000_000, 5_000_000
RECORDS = 2_000_000


def read_by_ranges(path: Path, options: ReadOptions) -> int:
    form = get_format(path)
    n_points = form.info(path, options).n_points
    return sum(len(form.read(path, options, start=s, stop=s + CHUNK)) for s in range(0, n_points, CHUNK))


def read_with_laspy(path: Path, parallel: bool) -> int:
    backend = laspy.LazBackend.LazrsParallel if parallel else laspy.LazBackend.Lazrs
    count = 0
    with laspy.open(path, laz_backend=backend) as reader:
        for points in reader.chunk_iterator(CHUNK):
            scaled = np.stack([points.x, points.y, points.z], axis=1)
            columns = [np.array(points[name]) for name in points.point_format.dimension_names]
            count += len(scaled) if columns else 0
    return count


def unpack_with_lazrs(path: Path) -> int:
    """Decompress alone: what no reader can beat."""
    header = read_header(path)
    record = header.find(LASZIP)
    assert record is not None
    with path.open("rb") as stream:
        stream.seek(header.point_offset)
        selection = lazrs.DecompressionSelection(lazrs.SELECTIVE_DECOMPRESS_ALL)
        reader = lazrs.ParLasZipDecompressor(stream, record.data, selection)
        for start in range(0, header.n_points, CHUNK):
            reader.decompress_many(bytearray(min(CHUNK, header.n_points - start) * header.record_size))
    return header.n_points


def unpack_records(path: Path) -> int:
    header = read_header(path)
    with RecordReader(path, header, n_threads=2) as reader:
        return sum(len(reader.read(start, start + CHUNK)) for start in range(0, header.n_points, CHUNK))


def pack_with_lazrs(records: np.ndarray, path: Path, header: LasHeader) -> int:
    record = lazrs.LazVlr.new_for_compression(
        header.point_format, header.record_size - RECORD_SIZES[header.point_format]
    )
    with path.open("w+b") as stream:
        writer = lazrs.ParLasZipCompressor(stream, record)
        for start in range(0, len(records), CHUNK):
            writer.compress_many(np.frombuffer(records[start : start + CHUNK], np.uint8))
        writer.done()
    return len(records)


def pack_records_as_laz(records: np.ndarray, path: Path, header: LasHeader) -> int:
    with path.open("w+b") as stream:
        writer = RecordWriter(stream, header, compress=True, n_threads=2)
        for start in range(0, len(records), CHUNK):
            writer.write(records[start : start + CHUNK])
        writer.close()
    return len(records)


def relabel_with_laspy(source: Path, target: Path, parallel: bool) -> int:
    """Do the same work as far as laspy goes: no original classes, whole chunks, an extra dimension."""
    backend = laspy.LazBackend.LazrsParallel if parallel else laspy.LazBackend.Lazrs
    with laspy.open(source, laz_backend=backend) as reader:
        header = reader.header.copy()
        header.add_extra_dim(laspy.ExtraBytesParams("confidence", "f4"))
        start = 0
        with laspy.open(target, mode="w", header=header, laz_backend=backend, do_compress=True) as writer:
            for points in reader.chunk_iterator(CHUNK):
                out = laspy.ScaleAwarePointRecord.zeros(len(points), header=header)
                out.copy_fields_from(points)
                codes, confidence = labels_of(start, start + len(points))
                out["classification"][:] = codes
                out["confidence"][:] = confidence
                writer.write_points(out)
                start += len(points)
    return start


def labels_of(start: int, stop: int) -> tuple[np.ndarray, np.ndarray]:
    rows = np.arange(start, stop)
    return (rows // 64 % 80).astype(np.uint8), (rows % 101 / 101).astype(np.float32)


def measure(cases: dict[str, Callable[[], int]], *, repeats: int = REPEATS) -> None:
    """Run the cases alternately, and print the medians of each."""
    for name, timed in race(cases, repeats=repeats).items():
        other = next((program for program in OTHERS if name.endswith(", " + program)), None)
        show(name.removesuffix(f", {other}"), timed.result, {other or "mlsroad": timed})


def bench_records(laz: Path, out: Path) -> None:
    """Compress and decompress alone, beside the library that does it."""
    header = read_header(laz)
    with RecordReader(laz, header, n_threads=2) as reader:
        records = reader.read(0, RECORDS)
    measure(
        {
            "LAZ to records, 2 threads": lambda: unpack_records(laz),
            "LAZ to records, 2 threads, lazrs alone": lambda: unpack_with_lazrs(laz),
            "records to LAZ, 2 threads": lambda: pack_records_as_laz(records, out / "r.laz", header),
            "records to LAZ, 2 threads, lazrs alone": lambda: pack_with_lazrs(records, out / "r.bin", header),
        }
    )


def bench_inspect(laz: Path, out: Path) -> None:
    """Look through the file once, as `kedro run --pipelines=inspect` does."""
    del out

    def inspect() -> int:
        return int(inspect_file(str(laz), laz.name, options=ReadOptions(), max_gap=1.0).facts["n_points"])

    measure({"inspect": inspect}, repeats=1)


def bench_laz(laz: Path, out: Path) -> None:
    """Read whole clouds, beside laspy."""
    del out
    measure(
        {
            "read LAZ, 1 thread": lambda: read_by_ranges(laz, ReadOptions()),
            "read LAZ, 1 thread, laspy": lambda: read_with_laspy(laz, False),
            "read LAZ, 2 threads": lambda: read_by_ranges(laz, ReadOptions(n_threads=2)),
            "read LAZ, 2 threads, laspy": lambda: read_with_laspy(laz, True),
            "read LAZ coordinates and intensity, 2 threads": lambda: read_by_ranges(
                laz, ReadOptions(n_threads=2, only=("intensity",))
            ),
        }
    )


def bench_labels(laz: Path, out: Path) -> None:
    """Copy a survey with classes and confidences, beside laspy."""
    n_points = read_header(laz).n_points
    label = {t: lambda t=t: len(write_labelled(laz, out / "a.laz", labels_of, n_threads=t)) * n_points for t in (1, 2)}
    measure(
        {
            "write labelled LAZ, 1 thread": label[1],
            "write labelled LAZ, 1 thread, laspy": lambda: relabel_with_laspy(laz, out / "b.laz", False),
            "write labelled LAZ, 2 threads": label[2],
            "write labelled LAZ, 2 threads, laspy": lambda: relabel_with_laspy(laz, out / "b.laz", True),
        }
    )


def bench_text(laz: Path, out: Path) -> None:
    """Read and write tables; the text has five columns, the PLY colours too."""
    cloud = LasFormat().read(laz, ReadOptions(only=("intensity", "rgb", "gps_time")), stop=TABLE_POINTS)
    TextFormat().write(out / "a.txt", cloud, WriteOptions())
    PlyFormat().write(out / "a.ply", cloud, WriteOptions())
    measure(
        {
            "read text, 2 threads": lambda: read_by_ranges(out / "a.txt", ReadOptions(n_threads=2)),
            "read text, 1 thread": lambda: read_by_ranges(out / "a.txt", ReadOptions()),
            "read text, 1 thread, numpy.loadtxt": lambda: len(np.loadtxt(out / "a.txt", skiprows=1)),
            "read PLY": lambda: read_by_ranges(out / "a.ply", ReadOptions()),
            "write labelled text": lambda: (
                len(write_labelled(out / "a.txt", out / "t" / "a.laz", labels_of)[:1]) * len(cloud)
            ),
            "write labelled PLY": lambda: (
                len(write_labelled(out / "a.ply", out / "p" / "a.laz", labels_of)[:1]) * len(cloud)
            ),
        }
    )


def bench_long_text(laz: Path, out: Path) -> None:
    """Read five million lines of x, y, z, intensity and time; the file is made where it is not there."""
    path = out / "long.txt"
    if not path.exists():
        cloud = LasFormat().read(laz, ReadOptions(only=("intensity", "gps_time")), stop=TEXT_POINTS)
        TextFormat().write(path, cloud, WriteOptions())
    print(f"{path}: {path.stat().st_size / 1e6:.0f} MB")
    measure(
        {
            "read long text, 2 threads": lambda: read_by_ranges(path, ReadOptions(n_threads=2)),
            "read long text, 1 thread": lambda: read_by_ranges(path, ReadOptions()),
        }
    )


def bench_others(laz: Path, out: Path) -> None:
    """Read two million points with intensity from PCD and E57, each time from a file that has just been opened.

    pypcd4 maps the records; as one array they are float32. mlsroad returns coordinates in float64 that are checked.
    """
    del laz
    rng = np.random.default_rng(0)
    pcd, e57 = out / "a.pcd", out / "a.e57"
    values = rng.random((4, RECORDS))
    pypcd4.PointCloud.from_xyzi_points(values.T.astype(np.float32)).save(str(pcd))
    file = pye57.E57(str(e57), mode="w")
    file.write_scan_raw(dict(zip((*CARTESIAN, "intensity"), values, strict=True)))
    file.close()

    def read(path: Path) -> int:
        open_pcd.cache_clear()
        open_e57.cache_clear()
        return len(get_format(path).read(path, ReadOptions()))

    measure(
        {
            "read PCD": lambda: read(pcd),
            "read PCD, pypcd4": lambda: pypcd4.PointCloud.from_path(pcd).points,
            "read PCD, pypcd4 as one array": lambda: len(
                pypcd4.PointCloud.from_path(pcd).numpy(("x", "y", "z", "intensity"))
            ),
            "read E57": lambda: read(e57),
            "read E57, pye57": lambda: len(
                pye57.E57(str(e57)).read_scan(0, intensity=True, ignore_missing_fields=True)["intensity"]
            ),
        },
        repeats=7,
    )


GROUPS = {
    **{"records": bench_records, "inspect": bench_inspect, "laz": bench_laz, "labels": bench_labels},
    **{"text": bench_text, "long-text": bench_long_text, "others": bench_others},
}


def main() -> None:
    """Measure the groups."""
    arguments = parser(__doc__)
    arguments.add_argument("laz", nargs="?", type=Path, help="a LAZ file; else street_5M.laz of $MLSROAD_RIVALS")
    arguments.add_argument("--only", nargs="+", choices=GROUPS, default=list(GROUPS), help="groups to measure")
    arguments.add_argument("--folder", type=Path, help="where files are written, and kept; else a temporary folder")
    given = arguments.parse_args()
    if given.laz is None and "MLSROAD_RIVALS" not in os.environ:
        arguments.error("give a LAZ file, or set MLSROAD_RIVALS")
    laz = given.laz or RIVALS / "street_5M.laz"
    with tempfile.TemporaryDirectory() as folder:
        for name in given.only:
            GROUPS[name](laz, given.folder or Path(folder))
    print(json.dumps({"kernel": "peak memory", "mebibytes": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024}))


if __name__ == "__main__":
    main()

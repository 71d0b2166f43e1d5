"""Fuzz the readers of files, the requests of the page and the import of corrections, guided by coverage.

    python scripts/fuzz.py [--seconds 1200] [--seed 0] [--targets las trajectory ...] [--found FOLDER]

Mutates small sound inputs (`tests/helpers/mutations.py`). An input that reaches new lines of the package is mutated
further. A failure is an error that is not of `MlsRoadError`, a call of more than 20 s, or a cloud with another number
of points than its header says or with coordinates that are not finite. Each kind of failure is written into the folder.
"""

from __future__ import annotations

import argparse
import io
import json
import os
import resource
import shutil
import signal
import sys
import tempfile
import time
import traceback
import warnings
from collections.abc import Callable
from contextlib import nullcontext, redirect_stdout, suppress
from functools import cache
from pathlib import Path
from types import FrameType
from typing import Any
from unittest import mock

import laspy
import numpy as np
import pandas as pd

import mlsroad_pipeline
from mlsroad_pipeline.algorithms.core.exceptions import MlsRoadError
from mlsroad_pipeline.commands import corrections
from mlsroad_pipeline.formats.base import ReadOptions
from mlsroad_pipeline.formats.registry import get_format
from mlsroad_pipeline.review.delivery.files import Delivery
from mlsroad_pipeline.review.page_server.served_survey import _correction
from mlsroad_pipeline.surveys.given_classes import read_predictions
from mlsroad_pipeline.surveys.register_files import RegisterFile
from mlsroad_pipeline.surveys.trajectory_files import read_trajectory

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from helpers.corrected import save_as_tables  # of the tests
from helpers.mutations import mutated, mutated_geopackage, mutated_json, mutated_table
from helpers.page_output import FILES, write_output

PACKAGE = str(Path(mlsroad_pipeline.__file__).parent)
LONGEST = 20
N = 40


def read_cloud(path: Path) -> None:
    """Read a cloud, and check its length and coordinates."""
    form = get_format(path)
    n = form.info(path, ReadOptions()).n_points
    cloud = form.read(path, ReadOptions())
    assert len(cloud) == n, f"{len(cloud)} of {n} points"
    assert np.isfinite(cloud.world_xyz()).all(), "coordinates that are not finite"


def request(path: Path) -> None:
    """Check a decision of the page; the server refuses `ValueError` and the like itself."""
    try:
        wanted = json.loads(path.read_bytes())
        _correction(wanted if isinstance(wanted, dict) else {})
    except (ValueError, TypeError, OverflowError, RecursionError):
        return


@cache
def labelled() -> tempfile.TemporaryDirectory[str]:
    """Return a folder with a labelled survey, and a copy of its inventory as QGIS saves it."""
    folder = tempfile.TemporaryDirectory()
    write_output(Path(folder.name, "out"), crs="EPSG:25832")
    (record,) = Path(folder.name, "out").glob(".mlsroad/*/run.json")
    run = json.loads(record.read_text())
    run["settings"]["label"] = {"survey": "survey.laz"}
    run["summary"]["model"] = {"name": "own", "version": "1"}
    record.write_text(json.dumps(run))
    save_as_tables(Path(folder.name, "out/inventory.gpkg"), Path(folder.name, "tables.gpkg"))
    return folder


def import_edits(path: Path) -> None:
    """Import an edited file into a labelled survey without decisions, and prepare the delivery."""
    with tempfile.TemporaryDirectory() as folder:
        out = shutil.copytree(Path(labelled().name, "out"), Path(folder, "out"), copy_function=os.link)
        with (
            mock.patch.object(corrections, "one_line_errors", lambda **_: nullcontext()),
            redirect_stdout(io.StringIO()),
        ):
            corrections.import_corrections(str(path), str(out), "ann", FILES[1], True)
        assert len(Delivery(out).corrected.objects) < 100


def sound() -> dict[str, tuple[bytes, Callable[[Path], Any], Callable[..., bytes]]]:
    """Return the name of a file of each target, its content, its reader and how it is mutated."""
    rng, files = np.random.default_rng(0), {}
    xyz = rng.uniform(0, 50, (N, 3)) + np.array([389000, 5819000, 30])
    las = laspy.LasData(laspy.LasHeader(point_format=7, version="1.4"))
    las.header.offsets, las.header.scales = [389000, 5819000, 0], [0.001] * 3
    las.x, las.y, las.z = xyz.T
    las.gps_time, las.intensity = np.arange(N) / 10 + 2e8, rng.integers(0, 65535, N)
    for name in ("las", "laz"):
        stream = io.BytesIO()
        las.write(stream, do_compress=name == "laz")
        files[f"a.{name}"] = stream.getvalue(), read_cloud, mutated
    rows = "\n".join(" ".join(f"{v:.3f}" for v in row) for row in xyz)
    names = ("x", "y", "z")
    ply = (
        f"ply\nformat {{}} 1.0\nelement vertex {N}\n"
        + "".join(f"property double {n}\n" for n in names)
        + "end_header\n"
    )
    pcd = f"VERSION .7\nFIELDS x y z\nSIZE 8 8 8\nTYPE F F F\nCOUNT 1 1 1\nWIDTH {N}\nHEIGHT 1\nPOINTS {N}\nDATA {{}}\n"
    for kind, head, binary in (("ply", ply, "binary_little_endian"), ("pcd", pcd, "binary")):
        files[f"text.{kind}"] = (head.format("ascii") + rows).encode(), read_cloud, mutated
        files[f"binary.{kind}"] = head.format(binary).encode() + xyz.astype("<f8").tobytes(), read_cloud, mutated
    files["table.txt"] = (
        f"x y z intensity\n{rows.replace(chr(10), f' 7{chr(10)}')} 7\n".encode(),
        read_cloud,
        mutated_table,
    )
    path = pd.DataFrame(xyz.cumsum(axis=0) / 100, columns=list(names)).assign(time=np.arange(N) / 10)
    files["trajectory.csv"] = path.to_csv(index=False).encode(), read_trajectory, mutated_table
    kinds = pd.DataFrame(xyz, columns=list(names)).assign(id=range(N), kind="pole", height=5.0).drop(columns="z")
    files["register.csv"] = kinds.to_csv(index=False).encode(), lambda p: RegisterFile(p).read(None), mutated_table
    stream = io.BytesIO()
    np.save(stream, np.arange(N) % 5)
    files["labels.npy"] = stream.getvalue(), lambda p: read_predictions(p, 0, N, N, "a.las"), mutated
    decision = {"action": "change", "object_id": 3, "payload": {"class": "pole", "base": [1.0, 2.0, 3.0], "note": "x"}}
    files["decision.json"] = json.dumps(decision).encode(), request, mutated_json
    survey = Path(labelled().name)
    for name, edited in (("views", "out/inventory.gpkg"), ("tables", "tables.gpkg")):
        files[f"{name}.gpkg"] = (survey / edited).read_bytes(), import_edits, mutated_geopackage
    files["edited.laz"] = (survey / "out" / FILES[1]).read_bytes(), import_edits, mutated
    return files


def new_lines(call: Callable[[], Any], seen: set[tuple[int, int]]) -> bool:
    """Call a function; return whether it reached lines of the package that were not seen, which are added."""
    before = len(seen)

    def line(frame: FrameType, event: str, _: Any) -> Any:
        seen.add((id(frame.f_code), frame.f_lineno))
        return line

    sys.settrace(lambda frame, event, _: line if frame.f_code.co_filename.startswith(PACKAGE) else None)
    try:
        with suppress(MlsRoadError):  # damaged input is refused by such an error
            call()
    finally:
        sys.settrace(None)
    return len(seen) > before


def damaged(base: bytes, mutate: Callable[..., bytes], rng: np.random.Generator) -> bytes:
    """Return a mutated input; a table that is no text any more is mutated as bytes."""
    try:
        return mutate(base, rng)
    except (ValueError, IndexError):
        return bytes(mutated(base, rng))


def failure(path: Path, reader: Callable[[Path], Any], seen: set[tuple[int, int]], corpus: list[bytes]) -> str:
    """Read an input, which is kept where it reaches new lines; return how the reader failed, else nothing."""
    signal.alarm(LONGEST)
    try:
        if new_lines(lambda: reader(path), seen):
            corpus.append(path.read_bytes())
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # also panics of Rust
        frames = [f for f in traceback.extract_tb(error.__traceback__) if f.filename.startswith(PACKAGE)]
        where = f"{frames[-1].name} line {frames[-1].lineno}" if frames else "check"
        return f"{type(error).__name__} in {where}: {error!s:.200}"
    finally:
        signal.alarm(0)
    return ""


def main() -> None:
    """Fuzz the targets in turn; the exit status is the number of kinds of failures."""
    warnings.simplefilter("ignore")
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--seconds", type=float, default=1200.0)
    arguments.add_argument("--seed", type=int, default=0)
    arguments.add_argument("--targets", nargs="*", choices=list(sound()), default=list(sound()))
    arguments.add_argument("--found", type=Path, default=Path("fuzz_found"))
    options = arguments.parse_args()
    resource.setrlimit(resource.RLIMIT_AS, (6 << 30, 6 << 30))
    signal.signal(signal.SIGALRM, lambda *_: (_ for _ in ()).throw(TimeoutError(f"more than {LONGEST} s")))
    kinds: set[str] = set()
    for name in options.targets:
        content, reader, mutate = sound()[name]
        rng, corpus, seen = np.random.default_rng(options.seed), [content], set[tuple[int, int]]()
        end, runs = time.monotonic() + options.seconds / len(options.targets), 0
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / name
            path.write_bytes(content)
            reader(path)  # the sound input is not refused
            while time.monotonic() < end:
                base = corpus[int(rng.integers(len(corpus)))]
                case = content if not runs or not base else damaged(base, mutate, rng)
                path.write_bytes(case)
                kind = failure(path, reader, seen, corpus)
                if kind and f"{name}_{kind.partition(':')[0]}" not in kinds:
                    kinds.add(f"{name}_{kind.partition(':')[0]}")
                    options.found.mkdir(exist_ok=True)
                    (options.found / f"{len(kinds)}_{name}").write_bytes(case)
                    sys.stdout.write(f"{len(kinds)}_{name}: {kind}\n")
                runs += 1
        sys.stdout.write(f"{name}: {runs:,} inputs, {len(seen):,} lines, {len(corpus)} kept\n")
        sys.stdout.flush()
    sys.exit(len(kinds))


if __name__ == "__main__":
    main()

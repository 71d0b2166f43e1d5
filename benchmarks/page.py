"""Measure the page of a labelled survey: first picture, frames, decisions, memory of the server (PSS).

    python benchmarks/page.py street_mlsroad [--copies 5] [--work /tmp/page]

`street_mlsroad` is an output of `mlsroad label`. With `--copies` its labelled file is repeated, each copy beside the
one before, into an output below `--work`, which is removed at the end. Needs Chromium. Prints one line of JSON.
The time of the first picture is that from the command to its address plus that from the request of a running browser
to the picture.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import psutil
from _common import REPOSITORY, Tree, parser

sys.path.insert(0, str(REPOSITORY / "tests"))

from helpers.browser import browser_page
from helpers.page_output import served

from mlsroad_pipeline.formats.las.header import read_header
from mlsroad_pipeline.formats.las.records import RecordReader
from mlsroad_pipeline.formats.las.writer import RecordWriter
from mlsroad_pipeline.review.page_server.output_folder import OutputFolder

READY = "window.page?.model.tiles.state === 'ready' && !page.cloud.loading"


def repeated(output: OutputFolder, target: Path, copies: int) -> Path:
    """Write an output whose only labelled file has copies of the points side by side."""
    shutil.copytree(output.path, target, ignore=shutil.ignore_patterns("*.laz", ".page", "corrections.*"))
    source = output.path / output.cloud_names[0]
    header = read_header(source)
    with RecordReader(source, header, n_threads=2) as reader, (target / output.cloud_names[0]).open("wb") as stream:
        writer = RecordWriter(stream, header, compress=True, n_threads=2)
        width = 0
        for copy in range(copies):
            for start in range(0, header.n_points, 1_000_000):
                records = reader.read(start, start + 1_000_000).copy()
                if copy == 0:
                    width = max(width, int(records["X"].max()) - int(reader.read(0, 1)["X"][0]))
                records["X"] += copy * 2 * width
                writer.write(records)
        writer.close()
    return target


def measured(folder: Path) -> dict[str, object]:
    """Return the figures of a first opening and of a second one, which finds the tiles."""
    found: dict[str, object] = {}
    with tempfile.TemporaryDirectory() as place, browser_page(Path(place)) as tab:
        for name in ("first", "again"):
            begin = time.perf_counter()
            with served(folder) as server, Tree(psutil.Process(server.process.pid), interval=0.05) as tree:
                found[f"{name}_server_s"] = time.perf_counter() - begin
                tab.open(server.address, width=1440, height=900)
                tab.until("performance.getEntriesByName('first-picture').length > 0", seconds=120)
                mark = tab.js("performance.getEntriesByName('first-picture')[0].startTime") / 1000
                found[f"{name}_picture_s"] = float(found[f"{name}_server_s"]) + mark
                tab.until(READY, seconds=3600)
                found[f"{name}_ready_s"] = time.perf_counter() - begin
                time.sleep(2)
                tab.until(READY, seconds=600)
                time.sleep(2)
                found["n_points"] = tab.js("page.model.survey.n_points")
                found[f"{name}_drawn"] = tab.js("page.cloud.shown")
                found[f"{name}_frame_ms"] = tab.js("page.cloud.frame")
                found |= {f"{name}_{key}": value for key, value in latencies(tab).items()}
                found[f"{name}_server_mib"] = tree.largest["driver"] / 2**20
                found[f"{name}_builder_mib"] = tree.largest["workers"] / 2**20
    found["cache_bytes"] = sum(path.stat().st_size for path in folder.glob(".page/*/*"))
    return {key: round(value, 3) if isinstance(value, float) else value for key, value in found.items()}


def latencies(tab) -> dict[str, float]:
    """Return the times of decisions in milliseconds: medians and maxima until the server has answered."""
    decide = """(async () => { const times = []; const ids = page.model.objects.map((o) => o.id);
        for (let k = 0; k < 40; k++) { const begin = performance.now();
          await page.model.source.decide({action: 'accept', object_id: ids[k % ids.length]});
          times.push(performance.now() - begin); } return times; })()"""
    paint = """(async () => { const times = []; const { model } = page;
        const name = [...model.classNames.values()][0];
        for (let k = 0; k < 10; k++) { const o = model.objects[k % model.objects.length];
          const begin = performance.now();
          await model.source.paint({places: [o.place], radius: 0.5, class: name}).catch(() => {});
          times.push(performance.now() - begin); } return times; })()"""
    times, strokes = np.array(tab.js(decide)), np.array(tab.js(paint))
    return {
        "decision_ms": float(np.median(times)),
        "decision_most_ms": float(times.max()),
        "paint_ms": float(np.median(strokes)),
        "paint_most_ms": float(strokes.max()),
    }


def main() -> None:
    """Measure one output."""
    arguments = parser(__doc__)
    arguments.add_argument("output", type=Path)
    arguments.add_argument("--copies", type=int, default=0)
    arguments.add_argument("--work", type=Path, default=Path(tempfile.gettempdir()) / "mlsroad_page")
    arguments = arguments.parse_args()
    output = OutputFolder.find(arguments.output.resolve())
    if output is None:
        sys.exit(f"{arguments.output} is not a finished output of mlsroad label")
    target = arguments.work / "copies_mlsroad"
    shutil.rmtree(target, ignore_errors=True)
    try:
        begin = time.perf_counter()
        repeated(output, target, max(1, arguments.copies))
        print(f"written in {time.perf_counter() - begin:.0f} s", file=sys.stderr)
        cpu = subprocess.run(["uname", "-m"], capture_output=True, text=True, check=True).stdout.strip()
        print(json.dumps({"machine": cpu, "cores": psutil.cpu_count(), **measured(target)}))
    finally:
        shutil.rmtree(target, ignore_errors=True)


if __name__ == "__main__":
    main()

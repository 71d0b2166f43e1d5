"""Small labelled output for tests of the page, with awkward names, and its server as a user starts it."""

import http.client
import json
import os
import re
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

import laspy
import numpy as np
import shapely
from helpers.corrected import object_rows
from PIL import Image

from mlsroad_pipeline.algorithms.inventory.lines.extraction import line_row, line_table
from mlsroad_pipeline.algorithms.scenes.trajectory import Trajectory
from mlsroad_pipeline.execution.run_folder import entries_of
from mlsroad_pipeline.inventory_files.geopackage import write_geopackage
from mlsroad_pipeline.inventory_files.geoparquet import write_geoparquet
from mlsroad_pipeline.inventory_files.road_inventory import RoadInventory

EVIL = "<img src=x onerror=window.hacked=1>"
"""Name of a class, which a page must show as text."""
FILES = ("a <b>&'.laz", "sub/two.laz")
ORIGIN = np.array([500.0, 900.0, 12.0])
COMMAND = Path(sys.executable).with_name("mlsroad")


def road_points(rng, n=60_000):
    """Return points of a flat road (class 11) with a pole (64) at each of two places, and a patch of class 5."""
    ground = np.column_stack([rng.uniform(-5, 45, n), rng.uniform(-8, 8, n), rng.normal(0, 0.01, n)])
    poles = [
        np.column_stack([rng.normal(x, 0.05, 2000), rng.normal(0, 0.05, 2000), rng.uniform(0, 6, 2000)])
        for x in (0, 10)
    ]
    crown = rng.normal([20, 5, 4], 0.8, (4000, 3))
    xyz = np.concatenate([ground, *poles, crown])
    codes = np.repeat([11, 64, 64, 5], [n, 2000, 2000, 4000])
    return xyz, codes, np.repeat([0, 1, 2, 4], [n, 2000, 2000, 4000])


def write_laz(path, xyz, codes, objects, *, confidence=0.8):
    header = laspy.LasHeader(point_format=7, version="1.4")
    header.scales, header.offsets = [0.001] * 3, ORIGIN
    for name, kind in (("original_classification", "u1"), ("confidence", "f4"), ("object_id", "u4")):
        header.add_extra_dim(laspy.ExtraBytesParams(name, kind))
    las = laspy.LasData(header)
    las.xyz = xyz + ORIGIN
    las.classification, las.confidence, las.object_id = codes, np.full(len(xyz), confidence), objects
    las.original_classification = np.where(xyz[:, 0] > 30, 5, codes)
    las.intensity = np.arange(len(xyz)) % 500
    las.red, las.green, las.blue = (np.full(len(xyz), 256 * v) for v in (250, 20, 30))
    path.parent.mkdir(parents=True, exist_ok=True)
    las.write(str(path))


def write_output(folder, *, crs=None):
    """Write an output folder of two files, and return the points of both in order."""
    rng = np.random.default_rng(7)
    parts = []
    for name, shift in zip(FILES, (0.0, 50.0), strict=True):
        xyz, codes, objects = road_points(rng)
        objects = objects if shift == 0 else np.zeros_like(objects)
        write_laz(folder / name, xyz + [shift, 0, 0], codes, objects)
        parts.append((xyz + [shift, 0, 0] + ORIGIN, codes))
    table = object_rows()
    table["reasons"] = "reaches the ground; <b>bold</b>"
    reach = np.where(table["kind"] == "tree", 4.0, 1.0)
    for axis in "xy":
        table[f"{axis}_min"], table[f"{axis}_max"] = table[axis] - reach, table[axis] + reach
    table["z_min"], table["z_max"] = table["z"] - 1, table["z"] + 9
    table["footprint"] = [
        shapely.box(*row).wkt for row in table[["x_min", "y_min", "x_max", "y_max"]].to_numpy().tolist()
    ]
    path = Trajectory.from_positions(
        np.column_stack([np.linspace(495, 595, 50), np.full(50, 897.0), np.full(50, 14.0)])
    )
    kerb = np.array([[495.0, 895.0, 12.0], [540.0, 895.5, 12.1], [590.0, 896.0, 12.2]])
    inventory = RoadInventory(table, crs, path, None, line_table([line_row("kerb", kerb, path)]))
    write_geopackage(inventory, folder / "inventory.gpkg")
    write_geoparquet(inventory, folder / "inventory.parquet")
    (folder / "report.html").write_text("<script>window.ran = 1</script>report", encoding="utf-8")
    (folder / "photos").mkdir()
    Image.new("RGB", (40, 60), (200, 30, 30)).save(folder / "photos/1.jpg")
    classes = {"road": 11, "pole": 64, EVIL: 5, "wire": 14}
    run = {
        "format": 1,
        "state": "finished",
        "settings": {"classes": {"schemes": {"own": {"classes": {n: {"members": [], "asprs": c} for n, c in classes.items()}}}}},
        "summary": {"survey": "/far/<i>survey.laz", "classes": {"road": 1, "pole": 1, EVIL: 1}, "warnings": []},
        "outputs": [
            {**entry, "path": name}
            for name in (*FILES, "inventory.gpkg", "report.html")
            for entry in entries_of([str(folder / name)])
        ],
    }  # fmt: skip
    record = folder / ".mlsroad/0123456789ab/run.json"
    record.parent.mkdir(parents=True)
    record.write_text(json.dumps(run), encoding="utf-8")
    return np.concatenate([xyz for xyz, _ in parts]), np.concatenate([codes for _, codes in parts])


class Served:
    """A running `mlsroad open`: its port, its token, and requests with or without the cookie."""

    def __init__(self, process, address):
        self.process, self.address = process, re.search(r"http://\S+", address)[0]
        self.port = int(re.search(r":(\d+)/", self.address)[1])
        self.cookie = None

    def ask(self, path, *, method="GET", headers=(), body=None):
        """Return status, headers and body of a request; the host is that of the server unless given."""
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=30)
        sent = {"Host": f"127.0.0.1:{self.port}", **({"Cookie": self.cookie} if self.cookie else {}), **dict(headers)}
        connection.request(method, path, body=body, headers={k: v for k, v in sent.items() if v is not None})
        answer = connection.getresponse()
        content = answer.read()
        connection.close()
        return answer.status, {k.lower(): v for k, v in answer.getheaders()}, content

    def json(self, path):
        status, _, content = self.ask(path)
        assert status == 200, content
        return json.loads(content)

    def post(self, path, value, **headers):
        sent = {"Origin": f"http://127.0.0.1:{self.port}", "Content-Type": "application/json", **headers}
        status, _, content = self.ask(path, method="POST", headers=sent, body=json.dumps(value))
        return status, json.loads(content) if content.startswith(b"{") else content

    def sign_in(self):
        status, headers, _ = self.ask(self.address.partition(str(self.port))[2])
        assert status == 200
        self.cookie = headers["set-cookie"].partition(";")[0]
        return headers["set-cookie"]

    def until_ready(self):
        import time

        assert self.ask("/first.bin")[0] == 200
        for _ in range(600):
            if self.json("/api/status")["state"] == "ready":
                return
            time.sleep(0.05)
        raise AssertionError(self.json("/api/status"))


@contextmanager
def served(folder, *options):
    """Start the page of an output folder and end it with Ctrl-C."""
    variables = {k: v for k, v in os.environ.items() if not k.startswith(("MLFLOW_", "KEDRO_", "COV_"))}
    with subprocess.Popen(
        [COMMAND, "open", str(folder), "--no-browser", "--user", "ann", *options],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=variables | {"PYTHONUNBUFFERED": "1"},
    ) as process:  # fmt: skip
        try:
            line = process.stdout.readline()
            assert re.search(r"http://127\.0\.0\.1:\d+/\?token=\S+", line), (line, process.stderr.read())
            yield Served(process, line)
        finally:
            process.terminate()
            process.wait(timeout=30)

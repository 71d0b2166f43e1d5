"""Output folder of `label` as the page shows it: labelled files, classes, objects, path, photos."""

from __future__ import annotations

import sqlite3
import struct
from collections.abc import Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import ReadError
from mlsroad_pipeline.algorithms.core.palette import (
    KIND_COLOURS,
    LINE_COLOURS,
    class_palette,
    las_palette,
    rgb_to_hex,
)
from mlsroad_pipeline.algorithms.inventory.lines.layers import LINE_LAYERS
from mlsroad_pipeline.execution.run_identity import finished_record
from mlsroad_pipeline.review.page_server.cloud_files import CloudFiles


def resolved(folder: Path, name: str) -> Path | None:
    """Return a file below a folder, None if it is missing, hidden, or outside of the folder by `..` or a link."""
    parts = Path(name).parts
    if not parts or any(part.startswith(".") or "\0" in part for part in parts):
        return None
    try:
        path, root = (folder / name).resolve(strict=True), folder.resolve(strict=True)
    except OSError:
        return None
    return path if path.is_file() and path.is_relative_to(root) else None


PRIVATE = 64
"""First LAS code that producers of data may define."""

INVENTORY, REPORT, PHOTOS = "inventory.gpkg", "report.html", "photos"
_HIDDEN = ("fid", "geom", "geometry", "footprint", "method", "model_version")
_MOST_VERTICES = 5000
_ENVELOPES = (0, 32, 48, 48, 64)  # bytes of the envelope in the header of a GeoPackage geometry, by its code


@dataclass(frozen=True)
class OutputFolder:
    """A finished output of `label`."""

    path: Path  # The folder
    run: Mapping[str, Any]  # Record of its last finished run

    @classmethod
    def find(cls, path: Path) -> OutputFolder | None:
        """Return the output in a folder, None if no run is finished there; ReadError if its record is damaged."""
        record = finished_record(path)
        return None if record is None else cls(path, record)

    @property
    def name(self) -> str:
        """Name of the survey."""
        return Path(str(self.run["summary"]["survey"])).name

    @cached_property
    def cloud_names(self) -> list[str]:
        """Names of the labelled LAZ files below the folder."""
        names = [str(entry["path"]) for entry in self.run["outputs"]]
        return sorted(name for name in names if name.lower().endswith(".laz") and ".copc." not in name.lower())

    @cached_property
    def clouds(self) -> CloudFiles:
        """The labelled files; ReadError if there is none."""
        if not self.cloud_names:
            raise ReadError(f"{self.path} holds no labelled LAZ file: label the survey again")
        return CloudFiles.at(self.path, self.cloud_names)

    def class_names(self) -> dict[int, str]:
        """Return the names of the class codes: those of the scheme of the run, else those in the files."""
        found = self.clouds.class_names()
        is_standard = self.run.get("settings", {}).get("label", {}).get("scheme", "asprs") == "asprs"
        scheme = _scheme_of(self.run) if is_standard else {}
        return found | {int(spec["asprs"]): name for name, spec in scheme.items()}

    def colours(self) -> dict[str, dict[str, str]]:
        """Return the colours of class codes, kinds and lines: those of the report."""
        label = (self.run.get("settings") or {}).get("label") or {}
        names = self.class_names()
        by_code = dict(enumerate(map(rgb_to_hex, las_palette())))
        if label.get("scheme", "asprs") != "asprs":
            private = {code: name for code, name in names.items() if code >= PRIVATE}
            by_code |= dict(zip(private, map(rgb_to_hex, class_palette(tuple(private.values()))), strict=False))
        return {
            "classes": {str(code): by_code[code] for code in sorted({*names, *range(256)})},
            "kinds": KIND_COLOURS,
            "lines": LINE_COLOURS,
        }

    def objects(self) -> dict[str, Any]:
        """Return the objects of the inventory: names and headings of the columns, and rows of JSON values."""
        path = self.path / INVENTORY
        if not path.is_file():
            return {"columns": [], "headings": {}, "rows": []}
        with _reading(path) as base:
            columns = [row[1] for row in base.execute('PRAGMA table_info("objects")') if row[1] not in _HIDDEN]
            chosen = ", ".join('"{}"'.format(name.replace('"', '""')) for name in columns)
            rows = base.execute(f"SELECT {chosen} FROM objects ORDER BY object_id").fetchall() if columns else []
            named = _rows(base, "SELECT column_name, title FROM gpkg_data_columns WHERE table_name = 'objects'")
        return {"columns": columns, "headings": dict(named), "rows": [list(row) for row in rows]}

    def footprints(self) -> dict[str, list[list[float]]]:
        """Return the outlines of the objects, by number, as x, y in the order of the ring."""
        path = self.path / INVENTORY
        if not path.is_file():
            return {}
        with _reading(path) as base:
            rows = _rows(base, "SELECT object_id, geom FROM footprints")
            return {str(number): np.round(_vertices(blob)[:, :2], 2).tolist() for number, blob in rows if blob}

    def path_vertices(self) -> list[list[float]]:
        """Return the path of the scanner as x, y, z; empty if it is unknown."""
        path = self.path / INVENTORY
        if not path.is_file():
            return []
        with _reading(path) as base:
            rows = _rows(base, "SELECT geom FROM trajectory")
            vertices = _vertices(rows[0][0]) if rows else np.empty((0, 3))
        if not len(vertices):
            return []
        step = max(1, len(vertices) // _MOST_VERTICES)
        kept = np.concatenate([vertices[:-1:step], vertices[-1:]])
        rounded: list[list[float]] = np.round(kept, 3).tolist()
        return rounded

    def lines(self) -> list[dict[str, Any]]:
        """Return the lines of the inventory: their fields as JSON values, and `vertices` as x, y, z."""
        path = self.path / INVENTORY
        if not path.is_file():
            return []
        with _reading(path) as base:
            found: list[dict[str, Any]] = []
            for layer in LINE_LAYERS:
                names = [row[1] for row in base.execute(f'PRAGMA table_info("{layer}")')]
                rows = (dict(zip(names, row, strict=True)) for row in _rows(base, f"SELECT * FROM {layer}"))
                for row in rows:
                    vertices = np.round(_vertices(row.pop("geom")), 3).tolist()
                    found.append({**{n: v for n, v in row.items() if n != "fid"}, "vertices": vertices})
            return found

    def photos(self) -> list[int]:
        """Return the numbers of the objects that have a photo."""
        names = (path.stem for path in self.path.glob(f"{PHOTOS}/*.jpg"))
        return sorted(int(name) for name in names if name.isdigit())


def _scheme_of(run: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the classes of the scheme of the configuration that has all classes of the summary, the smallest one."""
    counted = {name for name in run["summary"].get("classes", ()) if name != "unlabelled"}
    schemes = (run.get("settings", {}).get("classes") or {}).get("schemes", {})
    fitting = [spec["classes"] for spec in schemes.values() if counted and counted <= set(spec.get("classes", ()))]
    return min(fitting, key=len) if fitting else {}


@contextmanager
def _reading(path: Path) -> Iterator[sqlite3.Connection]:
    try:
        with closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True)) as base:
            yield base
    except (sqlite3.Error, struct.error, IndexError, ValueError, TypeError) as error:
        raise ReadError(
            f"{path} is damaged, or not an inventory of mlsroad ({error}): label the survey again"
        ) from error


def _rows(base: sqlite3.Connection, query: str) -> list[tuple[Any, ...]]:
    """Return the rows of a layer that may be missing."""
    try:
        return base.execute(query).fetchall()
    except sqlite3.OperationalError as error:
        if "no such" in str(error):  # table or column
            return []
        raise


def _vertices(blob: bytes) -> NDArray[np.float64]:
    """Return the vertices of a line or of the outer ring of a polygon in a GeoPackage, shape (n, 2 or 3)."""
    at = 8 + _ENVELOPES[blob[3] >> 1 & 7]
    order = "<" if blob[at] == 1 else ">"
    (kind,) = struct.unpack_from(f"{order}I", blob, at + 1)
    flat = kind & 0x0FFFFFFF
    width = 3 if kind & 0x80000000 or flat // 1000 in (1, 3) else 2
    at += 5 + (4 if flat % 1000 == 3 else 0)  # a polygon states the number of its rings
    (count,) = struct.unpack_from(f"{order}I", blob, at)
    return np.frombuffer(blob, f"{order}f8", count * width, at + 4).reshape(count, width)

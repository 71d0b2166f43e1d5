"""Targets of the fuzzer: sound inputs, how they are damaged and read, and the checks of what was read."""

import hashlib
import io
import json
import os
import shutil
import tarfile
import tempfile
from collections.abc import Callable, Iterable
from contextlib import nullcontext, redirect_stdout
from functools import cache, partial
from pathlib import Path
from typing import Any, NamedTuple
from unittest import mock

import laspy
import numpy as np
from formats import test_fuzz as clouds
from helpers import page_output
from helpers.corrected import save_as_tables
from helpers.mutations import mutated, mutated_geopackage, mutated_json, mutated_table
from helpers.page_output import FILES
from surveys import test_fuzz_sides as sides

from mlsroad_pipeline.algorithms.core.exceptions import MlsRoadError
from mlsroad_pipeline.commands import corrections
from mlsroad_pipeline.formats.base import ReadOptions
from mlsroad_pipeline.formats.registry import get_format
from mlsroad_pipeline.review.corrections import has_corrections
from mlsroad_pipeline.review.delivery.files import Delivery
from mlsroad_pipeline.review.page_server.output_folder import OutputFolder
from mlsroad_pipeline.review.page_server.served_survey import ServedSurvey
from mlsroad_pipeline.review.page_server.tile_building import build_tiles
from mlsroad_pipeline.surveys.given_classes import read_predictions
from mlsroad_pipeline.surveys.register_files import RegisterFile

CORPUS = Path(__file__).resolve().parents[1] / "fuzz_corpus.tar.xz"
"""Small inputs that reached new branches, by group and target."""

KEPT = 100
"""Accepted requests after which the decisions of the page are deleted."""

TABLE = b"id,kind,x,y,height\n" + b"".join(b"%d,pole,%d,2.5,5.0\n" % (i, 389000 + i) for i in range(9))
LINE = {"line": 1, "x": 495.0, "y": 895.0}
PART = [[495.0, 895.0, 12.0], [540.0, 895.5, 12.1]]
REQUESTS: dict[str, tuple[dict[str, Any], ...]] = {
    "decide": (
        {"action": "other_kind", "object_id": 3, "kind": "pole", "payload": {"class": "pole"}},
        {"action": "merge", "object_id": 1, "payload": {"objects": [2]}},
        {"action": "split", "object_id": 4, "payload": {"bases": [[520.0, 905.0, 12.0], [521.0, 905.0, 12.0]]}},
        {"action": "move_base", "object_id": 1, "payload": {"x": 501.0, "y": 900.0, "z": 12.0}},
        {"action": "add", "kind": "tree", "payload": {"x": 530.0, "y": 900.0, "z": 12.0, "note": "x"}},
        {"action": "note", "object_id": 2, "payload": {"note": "x", "attributes": {"material": "steel"}}},
        {"action": "paint", "payload": {"file": FILES[0], "points": [1, 2, 3], "class": "wire"}},
        {"action": "cut_line", "kind": "kerb", "payload": {**LINE, "parts": [PART, PART]}},
        {"action": "join_lines", "kind": "kerb", "payload": {**LINE, "other": {**LINE, "kind": "kerb"}, "parts": [PART]}},
        {"action": "kind_line", "kind": "kerb", "payload": {**LINE, "to": "wire"}},
        {"all": [{"action": "accept", "object_id": 1}, {"action": "reject", "object_id": 2}]},
    ),
    "undo": ({"ids": [1]},),
    "paint": (
        {"places": [[520.0, 905.0, 16.0]], "radius": 0.3, "class": "wire", "only": 5},
        {"places": [[500.0, 900.0, 14.0]], "cluster": True, "class": "road", "only": 64},
    ),
    "group": ({"places": [[520.0, 905.0, 16.0]], "only": 5},),
    "leave_out": ({"places": [[520.0, 905.0, 16.0]], "back": True},),
    "deliver": ({"formats": [".csv"], "checked": True},),
}  # fmt: skip


class Target(NamedTuple):
    """A file that is damaged, how it is mutated and read, and the folder with the files beside it."""

    path: Path
    mutate: Callable[[bytes, np.random.Generator], bytes]
    reader: Callable[[Path], Any]
    seeds: list[bytes]

    def read(self, content: bytes) -> None:
        """Read a content of the file."""
        self.path.write_bytes(content)
        self.reader(self.path)


def read_cloud(path: Path) -> None:
    """Read a cloud whole and in part, and check its length and coordinates."""
    form = get_format(path)
    n = form.info(path, ReadOptions()).n_points
    cloud = form.read(path, ReadOptions())
    world = cloud.world_xyz()
    assert len(cloud) == n, f"{len(cloud)} of {n} points"
    assert np.isfinite(world).all(), "coordinates that are not finite"
    part = form.read(path, ReadOptions(), start=n // 3, stop=n // 2)
    assert np.array_equal(part.world_xyz(), world[n // 3 : n // 2]), "a part has other coordinates"
    if path.suffix in (".las", ".laz"):
        compare_with_laspy(path, world)


def compare_with_laspy(path: Path, world: np.ndarray) -> None:
    """Compare the coordinates with those of laspy, which refuses other files."""
    try:
        xyz = np.asarray(laspy.read(path).xyz)
    except Exception:  # laspy raises errors of all kinds for damaged files
        return
    both = min(len(xyz), len(world))  # a header with a wrong number of points is mended by the reader, with a note
    assert np.allclose(xyz[:both], world[:both], rtol=1e-9, atol=1e-4), "laspy reads other coordinates"


class Page:
    """Page of a labelled survey, and the requests to it."""

    def __init__(self, out: Path) -> None:
        self.out, self.accepted = out, 0
        self.survey = self._opened()
        build_tiles(self.survey.output.clouds, self.survey.tiles.folder)

    def _opened(self) -> ServedSurvey:
        return ServedSurvey(OutputFolder.find(self.out), user="ann")

    def request(self, path: Path) -> None:
        """Do what a request asks for, as the server does; after an accepted one the page and the delivery must work."""
        act, _, body = path.read_bytes().partition(b"\n")
        try:
            wanted = json.loads(body)
            if act.decode() not in REQUESTS or not isinstance(wanted, dict):
                return
            answer = getattr(self.survey, act.decode())(wanted)
            json.dumps(answer, allow_nan=False)
        except (MlsRoadError, ValueError, TypeError, OverflowError, RecursionError):
            return  # answered by 400 or 409
        finally:
            for folder in self.out.glob("delivery-*"):
                shutil.rmtree(folder)
        try:
            json.dumps([self.survey.corrections(), self.survey.queue(50)], allow_nan=False)
            self.accepted += 1
            if self.accepted % 10 == 0:
                assert len(Delivery(self.out).corrected.objects) < 1000
        except BaseException as error:
            self.accepted = KEPT
            if isinstance(error, MlsRoadError):
                raise AssertionError(f"accepted, then refused: {error}") from error
            raise
        finally:
            if self.accepted >= KEPT:
                self._delete_decisions()

    def _delete_decisions(self) -> None:
        self.survey.store.close()
        (self.out / "corrections.sqlite").unlink()
        self.survey, self.accepted = self._opened(), 0


@cache
def labelled() -> Path:
    """Return a folder with a labelled survey, and a copy of its inventory as QGIS saves it."""
    folder = Path(tempfile.mkdtemp())
    with mock.patch.object(page_output, "road_points", partial(page_output.road_points, n=2000)):
        page_output.write_output(folder / "out", crs="EPSG:25832")
    (record,) = folder.glob("out/.mlsroad/*/run.json")
    run = json.loads(record.read_text())
    run["settings"]["label"] = {"survey": "survey.laz"}
    run["summary"]["model"] = {"name": "own", "version": "1"}
    record.write_text(json.dumps(run))
    save_as_tables(folder / "out/inventory.gpkg", folder / "tables.gpkg")
    return folder


def import_edits(path: Path) -> None:
    """Import an edited file into a labelled survey without decisions, and prepare the delivery."""
    with tempfile.TemporaryDirectory() as folder:
        out = shutil.copytree(labelled() / "out", Path(folder, "out"), copy_function=os.link)
        with (
            mock.patch.object(corrections, "one_line_errors", lambda **_: nullcontext()),
            redirect_stdout(io.StringIO()),
        ):
            corrections.import_corrections(str(path), str(out), "ann", FILES[1], True)
        if has_corrections(out):
            assert len(Delivery(out).corrected.objects) < 100


def mutated_request(data: bytes, rng: np.random.Generator) -> bytes:
    """Return a request with a damaged body."""
    act, mark, body = data.partition(b"\n")
    return act + mark + bytes(mutated_json(body, rng))


def reader_targets(folder: Path) -> list[Target]:
    """Return the readers of clouds and of the files beside them."""
    found, rng = [], np.random.default_rng(0)
    for family, name in clouds.NAMES.items():
        path = folder / family / name
        path.parent.mkdir()
        clouds.make_seed(family, path, rng)
        found.append(Target(path, mutated, read_cloud, []))
    for kind, (name, content, damage, reader) in sides.KINDS.items():
        place = folder / kind
        place.mkdir()
        if callable(content):
            content(place)
        else:
            (place / name).write_bytes(content.encode() if isinstance(content, str) else content)
        found.append(Target(place / name, damage, reader, []))
    (folder / "register.csv").write_bytes(TABLE)
    np.save(folder / "labels.npy", np.arange(40) % 5)
    found.append(Target(folder / "register.csv", mutated_table, lambda path: RegisterFile(path).read(None), []))
    found.append(Target(folder / "labels.npy", mutated, lambda path: read_predictions(path, 0, 40, 40, "a.las"), []))
    return [target._replace(seeds=[target.path.read_bytes()]) for target in found]


def targets(group: str, folder: Path) -> list[Target]:
    """Return the targets of a group; their files lie below a folder."""
    if group == "readers":
        return reader_targets(folder)
    out = labelled() / "out"
    if group == "requests":
        seeds = [f"{act}\n{json.dumps(body)}".encode() for act, bodies in REQUESTS.items() for body in bodies]
        return [Target(folder / "request", mutated_request, Page(out).request, seeds)]
    edited = {"views.gpkg": out / "inventory.gpkg", "tables.gpkg": labelled() / "tables.gpkg", "a.laz": out / FILES[1]}
    return [
        Target(folder / name, mutated if name == "a.laz" else mutated_geopackage, import_edits, [path.read_bytes()])
        for name, path in edited.items()
    ]


def corpus(group: str, target: str) -> list[bytes]:
    """Return the inputs of a target that are kept with the tests."""
    return [content for name, content in _kept().items() if name.rpartition("/")[0] == f"{group}/{target}"]


@cache
def _kept() -> dict[str, bytes]:
    with tarfile.open(CORPUS) as packed:
        return {entry.name: packed.extractfile(entry).read() for entry in packed}


def n_kept(group: str) -> int:
    """Return the number of inputs of a group that are kept with the tests."""
    return sum(name.startswith(f"{group}/") for name in _kept())


def keep(group: str, contents: Iterable[tuple[str, bytes]]) -> None:
    """Replace the inputs of a group that are kept with the tests; an input has a target and a content."""
    others = {name: content for name, content in _kept().items() if not name.startswith(f"{group}/")}
    own = {f"{group}/{target}/{hashlib.sha256(content).hexdigest()[:8]}": content for target, content in contents}
    with tarfile.open(CORPUS, "w:xz", preset=9) as packed:  # copies of a file take little room
        for name, content in sorted((others | own).items()):
            entry = tarfile.TarInfo(name)
            entry.size = len(content)
            packed.addfile(entry, io.BytesIO(content))

"""Tiles of a survey, built out of core: points are sorted into cubes on disk, then each cube into levels of detail."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import MlsRoadError
from mlsroad_pipeline.review.page_server.cloud_files import Block, CloudFiles
from mlsroad_pipeline.review.page_server.first_picture import has_colours
from mlsroad_pipeline.review.page_server.tile_format import (
    LEVELS,
    POINT,
    TileIndex,
    depth,
    level_file,
    pack,
    point_bytes,
)
from mlsroad_pipeline.review.page_server.tile_levels import nodes_of_cube

BLOCK = 500_000
EDGE, LEAST_EDGE = 32.0, 2.0
"""Edge of a cube in metres, and the smallest to which it is halved in dense surveys."""
MOST_IN_CUBE = 1_500_000
"""Estimated points of a cube above which the edge is halved."""
_READING = 0.6  # share of the first pass in the time
_SPARE = 200_000_000  # bytes that stay free on the disk

Cube = tuple[int, int, int]


class NoSpaceError(MlsRoadError):
    """The disk has no room for the tiles."""


def unfinished(folder: Path) -> Path:
    """Return the folder in which the tiles of a folder are built."""
    return folder.with_name(f"{folder.name}.part")


def build_tiles(clouds: CloudFiles, folder: Path, *, progress: Callable[[float], None] = lambda share: None) -> None:
    """Write the tiles of a survey to a folder; memory does not depend on the number of points.

    Raises NoSpaceError if the disk has no room.
    """
    working = unfinished(folder)
    shutil.rmtree(working, ignore_errors=True)
    working.mkdir(parents=True)
    try:
        _check_room(clouds.n_points, working)
        sample = [block.xyz for block in clouds.sample(200_000)]
        edge = cube_edge(np.concatenate(sample), clouds.n_points)
        scratch = working / "scratch.bin"
        parts, counts = _sort_into_cubes(clouds, scratch, edge, lambda share: progress(_READING * share))
        coloured = has_colours(clouds)
        nodes = _write_levels(
            scratch, parts, working, coloured, lambda share: progress(_READING + (1 - _READING) * share)
        )
        scratch.unlink()
        facts = {"n_points": clouds.n_points, "classes": {str(code): n for code, n in counts.items()}}
        TileIndex(working, edge, coloured, nodes).write(facts)
        _sync(working)
        shutil.rmtree(folder, ignore_errors=True)  # damaged ones
        os.replace(working, folder)
    finally:
        shutil.rmtree(working, ignore_errors=True)


def _sync(folder: Path) -> None:
    """Wait until all files of a folder are on the disk."""
    for path in folder.iterdir():
        with path.open("rb") as stream:
            os.fsync(stream.fileno())


def _check_room(n_points: int, folder: Path) -> None:
    needed = n_points * (POINT.itemsize + point_bytes(True)) + _SPARE
    free = shutil.disk_usage(folder).free
    if free < needed:
        raise NoSpaceError(
            f"{folder.parent}: the page needs {needed / 1e9:.1f} GB of disk while it is prepared, {free / 1e9:.1f} GB "
            "are free: free some, and open the page again"
        )


def cube_edge(sample: NDArray[np.float64], n_points: int) -> float:
    """Return the edge of the cubes, estimated from a sample of the points."""
    edge = EDGE
    while edge > LEAST_EDGE and len(sample):
        _, counts = np.unique(np.floor(sample / edge).astype(np.int64), axis=0, return_counts=True)
        if counts.max() * n_points / len(sample) <= MOST_IN_CUBE:
            break
        edge /= 2
    return edge


def _sort_into_cubes(
    clouds: CloudFiles, scratch: Path, edge: float, progress: Callable[[float], None]
) -> tuple[dict[Cube, list[tuple[int, int]]], dict[int, int]]:
    """Write all points to a file, those of a cube in runs; return the runs of each cube and the points per class."""
    parts: dict[Cube, list[tuple[int, int]]] = {}
    counts = np.zeros(256, dtype=np.int64)
    done = 0
    with scratch.open("wb") as stream:
        for block in clouds.blocks(BLOCK):
            counts += np.bincount(block.values["class"], minlength=256)
            cubes, points = sorted_by_cube(block, edge)
            begins = np.flatnonzero(np.concatenate([[True], (cubes[1:] != cubes[:-1]).any(axis=1)]))
            for begin, end in zip(begins.tolist(), [*begins[1:].tolist(), len(points)], strict=True):
                x, y, z = cubes[begin].tolist()
                parts.setdefault((x, y, z), []).append((done + begin, end - begin))
            points.tofile(stream)
            done += len(points)
            progress(done / max(1, clouds.n_points))
    return parts, {code: int(n) for code, n in enumerate(counts) if n}


def sorted_by_cube(block: Block, edge: float) -> tuple[NDArray[np.int64], NDArray]:
    """Return the cubes of points and the points within them, sorted by cube."""
    cubes = np.floor(block.xyz / edge).astype(np.int64)
    steps = np.minimum((block.xyz - cubes * edge) * (65536 / edge), 65535).astype(np.uint16)
    order = np.lexsort(cubes.T)
    points = np.empty(len(order), dtype=POINT)
    points["xyz"] = steps[order]
    for name in block.values.dtype.names or ():
        points[name] = block.values[name][order]
    return cubes[order], points


def _write_levels(
    scratch: Path,
    parts: dict[Cube, list[tuple[int, int]]],
    folder: Path,
    coloured: bool,
    progress: Callable[[float], None],
) -> NDArray[np.int64]:
    """Write the chunks of all cubes to the files of their levels and return the nodes."""
    nodes: list[tuple[int, ...]] = []
    written = [0] * LEVELS
    with ExitStack() as stack:
        source: Any = stack.enter_context(scratch.open("rb"))
        targets: list[BinaryIO] = [stack.enter_context((folder / level_file(i)).open("wb")) for i in range(LEVELS)]
        for number, (cube, runs) in enumerate(parts.items()):
            points = _read_runs(source, runs)
            for node in nodes_of_cube(points["xyz"]):
                targets[node.level].write(pack(points[node.rows], coloured=coloured))
                cell = [(place << depth(node.level)) + part for place, part in zip(cube, node.cell, strict=True)]
                nodes.append((node.level, *cell, written[node.level], len(node.rows)))
                written[node.level] += len(node.rows)
            progress((number + 1) / len(parts))
    return np.array(nodes, dtype=np.int64).reshape(-1, 6)


def _read_runs(source: Any, runs: list[tuple[int, int]]) -> NDArray:
    points = np.empty(sum(count for _, count in runs), dtype=POINT)
    at = 0
    for first, count in runs:
        source.seek(first * POINT.itemsize)
        points[at : at + count] = np.fromfile(source, POINT, count)
        at += count
    return points

"""Tiles of a survey, built out of core: points are sorted into cubes, each cube into levels of detail."""

import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import MlsRoadError
from mlsroad_pipeline.review.page_server import tile_format
from mlsroad_pipeline.review.page_server.cloud_files import Block, CloudFiles

LARGEST = 20_000
"""Points of a node that is not divided further."""
BITS = 16


class Node(NamedTuple):
    """Points of a node: level, cell below the cube, rows of the cube's points."""

    level: int
    cell: tuple[int, int, int]
    rows: NDArray[np.int64]


def morton(steps: NDArray[np.uint16]) -> NDArray[np.uint64]:
    """Return the Morton codes of steps, x in the lowest bit."""
    code = np.zeros(len(steps), dtype=np.uint64)
    for axis in range(3):
        code |= _spread(steps[:, axis]) << np.uint64(axis)
    return code


def _spread(values: NDArray[np.uint16]) -> NDArray[np.uint64]:
    """Return values with two zero bits after each bit."""
    out = values.astype(np.uint64)
    for shift, mask in ((16, 0x00FF0000FF0000FF), (8, 0xF00F00F00F00F00F), (4, 0x30C30C30C30C30C3)):
        out = (out | out << np.uint64(shift)) & np.uint64(mask)
    return (out | out << np.uint64(2)) & np.uint64(0x9249249249249249)


def nodes_of_cube(steps: NDArray[np.uint16]) -> Iterator[Node]:
    """Yield the nodes of a cube, coarse levels first; each point is in one node.

    A node of a level has one point of each of its cells; nodes below take the rest. From level 2 on a node
    takes all that remains if that is at most `LARGEST` points, and nodes of the last level take all.
    """
    codes = morton(steps)
    rest = np.argsort(codes, kind="stable")
    codes = codes[rest]
    for level in range(tile_format.LEVELS):
        if not len(rest):
            return
        of_node = codes >> np.uint64(3 * (BITS - tile_format.depth(level)))
        starts = _starts(of_node)
        taken = _first_of_cells(codes, level)
        if level >= tile_format.UNDIVIDED - 1:
            counts = np.diff(starts, append=len(codes))
            taken |= np.repeat((counts <= LARGEST) | (level == tile_format.LEVELS - 1), counts)
        picked = np.flatnonzero(taken)
        begins = _starts(of_node[picked])
        for begin, end in zip(begins, [*begins[1:], len(picked)], strict=True):
            code = int(of_node[picked[begin]])
            yield Node(level, _cell(code, tile_format.depth(level)), rest[picked[begin:end]])
        rest, codes = rest[~taken], codes[~taken]


def _starts(values: NDArray[np.uint64]) -> NDArray[np.int64]:
    return np.flatnonzero(np.concatenate([[True], values[1:] != values[:-1]])) if len(values) else np.empty(0, np.int64)


def _first_of_cells(codes: NDArray[np.uint64], level: int) -> NDArray[np.bool_]:
    cells = codes >> np.uint64(3 * (BITS - tile_format.COARSEST - level))
    taken = np.ones(len(codes), dtype=np.bool_)
    taken[1:] = cells[1:] != cells[:-1]
    return taken


def _cell(code: int, bits: int) -> tuple[int, int, int]:
    cell = [0, 0, 0]
    for bit in range(bits):
        for axis in range(3):
            cell[axis] |= (code >> (3 * bit + axis) & 1) << bit
    return cell[0], cell[1], cell[2]


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
        coloured = tile_format.has_colours(clouds)
        nodes = _write_levels(
            scratch, parts, working, coloured, lambda share: progress(_READING + (1 - _READING) * share)
        )
        scratch.unlink()
        facts = {"n_points": clouds.n_points, "classes": {str(code): n for code, n in counts.items()}}
        tile_format.TileIndex(working, edge, coloured, nodes).write(facts)
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
    needed = n_points * (tile_format.POINT.itemsize + tile_format.point_bytes(True)) + _SPARE
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
    points = np.empty(len(order), dtype=tile_format.POINT)
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
    written = [0] * tile_format.LEVELS
    with ExitStack() as stack:
        source: Any = stack.enter_context(scratch.open("rb"))
        targets: list[BinaryIO] = [
            stack.enter_context((folder / tile_format.level_file(i)).open("wb")) for i in range(tile_format.LEVELS)
        ]
        for number, (cube, runs) in enumerate(parts.items()):
            points = _read_runs(source, runs)
            for node in nodes_of_cube(points["xyz"]):
                targets[node.level].write(tile_format.pack(points[node.rows], coloured=coloured))
                cell = [
                    (place << tile_format.depth(node.level)) + part for place, part in zip(cube, node.cell, strict=True)
                ]
                nodes.append((node.level, *cell, written[node.level], len(node.rows)))
                written[node.level] += len(node.rows)
            progress((number + 1) / len(parts))
    return np.array(nodes, dtype=np.int64).reshape(-1, 6)


def _read_runs(source: Any, runs: list[tuple[int, int]]) -> NDArray:
    points = np.empty(sum(count for _, count in runs), dtype=tile_format.POINT)
    at = 0
    for first, count in runs:
        source.seek(first * tile_format.POINT.itemsize)
        points[at : at + count] = np.fromfile(source, tile_format.POINT, count)
        at += count
    return points

"""Nodes and levels of detail of the points of one cube."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.review.page_server.tile_format import COARSEST, LEVELS, UNDIVIDED, depth

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
    for level in range(LEVELS):
        if not len(rest):
            return
        of_node = codes >> np.uint64(3 * (BITS - depth(level)))
        starts = _starts(of_node)
        taken = _first_of_cells(codes, level)
        if level >= UNDIVIDED - 1:
            counts = np.diff(starts, append=len(codes))
            taken |= np.repeat((counts <= LARGEST) | (level == LEVELS - 1), counts)
        picked = np.flatnonzero(taken)
        begins = _starts(of_node[picked])
        for begin, end in zip(begins, [*begins[1:], len(picked)], strict=True):
            code = int(of_node[picked[begin]])
            yield Node(level, _cell(code, depth(level)), rest[picked[begin:end]])
        rest, codes = rest[~taken], codes[~taken]


def _starts(values: NDArray[np.uint64]) -> NDArray[np.int64]:
    return np.flatnonzero(np.concatenate([[True], values[1:] != values[:-1]])) if len(values) else np.empty(0, np.int64)


def _first_of_cells(codes: NDArray[np.uint64], level: int) -> NDArray[np.bool_]:
    cells = codes >> np.uint64(3 * (BITS - COARSEST - level))
    taken = np.ones(len(codes), dtype=np.bool_)
    taken[1:] = cells[1:] != cells[:-1]
    return taken


def _cell(code: int, bits: int) -> tuple[int, int, int]:
    cell = [0, 0, 0]
    for bit in range(bits):
        for axis in range(3):
            cell[axis] |= (code >> (3 * bit + axis) & 1) << bit
    return cell[0], cell[1], cell[2]

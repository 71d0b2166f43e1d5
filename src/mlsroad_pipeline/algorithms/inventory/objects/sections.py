"""Sections of a road: numbers of objects by station."""

from collections.abc import Sequence

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.validation import check_positive
from mlsroad_pipeline.algorithms.inventory.objects.rules import KINDS
from mlsroad_pipeline.algorithms.scenes.trajectory import Trajectory

STEP = 100.0
"""Length of a section, metres."""


def equal_sections(length: float, *, step: float = STEP) -> pd.DataFrame:
    """Return sections of equal length; the last one ends with the road."""
    check_positive(step, "step")
    starts = np.arange(max(1, int(np.ceil(round(length / step, 9))))) * step
    ends = np.append(starts[1:], length)
    return pd.DataFrame({"section": np.arange(len(starts)) + 1, "from_station": starts, "to_station": ends})


def section_table(objects: pd.DataFrame, length: float, *, sections: pd.DataFrame | None = None) -> pd.DataFrame:
    """Return the number of objects of each kind in each section of a road."""
    given = equal_sections(length) if sections is None else sections
    missing = [name for name in ("section", "from_station", "to_station") if name not in given]
    if missing:
        raise DataError(f"a table of road sections needs the column {missing[0]}")
    backward = given[~(given["to_station"] >= given["from_station"])]
    if len(backward):
        name, low, high = next(backward[["section", "from_station", "to_station"]].itertuples(index=False, name=None))
        raise DataError(f"section {name} ends at {high}, before {low}")
    table = given[["section", "from_station", "to_station"]].reset_index(drop=True)
    table["length"] = table["to_station"] - table["from_station"]
    station = objects["station"].to_numpy(dtype=np.float64)
    station = np.clip(station, 0.0, length) if sections is None else station
    last = table["to_station"].max()
    kinds = [*KINDS, *sorted(set(objects["kind"]) - set(KINDS))]
    inside = [
        (station >= low) & ((station < high) | ((station == high) & (high == last)))
        for low, high in table[["from_station", "to_station"]].to_numpy(dtype=np.float64)
    ]
    for kind in kinds:
        of_kind = (objects["kind"] == kind).to_numpy()
        table[kind] = [int((mine & of_kind).sum()) for mine in inside]
    table["objects"] = table[kinds].sum(axis=1)
    return table


def line_lengths(
    lines: Sequence[NDArray[np.float64]], trajectory: Trajectory, table: pd.DataFrame
) -> NDArray[np.float64]:
    """Return the length of lines in each section of a road."""
    pieces = [_pieces(line) for line in lines if len(line) > 1]
    if not pieces:
        return np.zeros(len(table))
    middle, length = (np.concatenate(part) for part in zip(*pieces, strict=True))
    station, _ = trajectory.locate(middle)
    station = np.clip(station, 0.0, trajectory.length)
    last = table["to_station"].max()
    return np.array(
        [
            round(float(length[(station >= low) & ((station < high) | ((station == high) & (high == last)))].sum()), 1)
            for low, high in table[["from_station", "to_station"]].to_numpy(dtype=np.float64)
        ]
    )


def _pieces(line: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the middles and lengths of pieces of a line of at most 1 m."""
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line[:, :2], axis=0).T))])
    ends = np.linspace(0.0, way[-1], max(2, int(np.ceil(way[-1])) + 1))
    middle = (ends[1:] + ends[:-1]) / 2
    return np.column_stack([np.interp(middle, way, line[:, k]) for k in range(3)]), np.diff(ends)


def part_of_path(trajectory: Trajectory, begin: float, end: float) -> NDArray[np.float64]:
    """Return the positions of a trajectory between two stations, with interpolated ends."""
    station, xyz = trajectory.station, trajectory.xyz
    moving = np.append(True, np.diff(station) > 0)  # a standing vehicle has several positions at one station
    low, high = np.clip([begin, end], station[0], station[-1])
    inside = moving & (station > low) & (station < high)
    ends = np.column_stack([np.interp([low, high], station[moving], column[moving]) for column in xyz.T])
    return np.concatenate([ends[:1], xyz[inside], ends[1:]])

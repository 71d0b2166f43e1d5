"""Bits that the colours and intensities of a LAS file use, from a sample."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Self

from mlsroad_pipeline.formats.files import FileKey, file_key, spread_starts
from mlsroad_pipeline.formats.las.header import read_header
from mlsroad_pipeline.formats.las.records import RecordReader
from mlsroad_pipeline.formats.standard_columns import COLOURS

SAMPLES, SAMPLE_SIZE = 8, 2000
"""Number of runs and points per run, evenly spread over the file, that determine the depth."""

EIGHT = 255


@lru_cache(maxsize=64)
def sampled_maximum(key: FileKey, names: tuple[str, ...]) -> int:
    """Return the maximum of fields of a sample that is spread over the whole file.

    Parameters
    ----------
    key : tuple
        See `file_key`.
    names : tuple of str
        Names of integer fields of the records.

    Returns
    -------
    int
        The maximum, 0 without points.
    """
    path = Path(key[0])
    header = read_header(path)
    greatest = 0
    with RecordReader(path, header) as reader:
        for start in spread_starts(header.n_points, SAMPLES, SAMPLE_SIZE):
            records = reader.read(start, start + SAMPLE_SIZE)
            greatest = max(greatest, *(int(records[name].max(initial=0)) for name in names))
    return greatest


def colour_bits(key: FileKey) -> int:
    """Return 8 where the 16-bit colour fields of a file hold 8-bit colours, else 16.

    Parameters
    ----------
    key : tuple
        See `file_key`.

    Returns
    -------
    int
        8 if no colour of the sample is above 255 and one is above zero.
    """
    return 8 if 0 < sampled_maximum(key, COLOURS) <= EIGHT else 16


@dataclass(frozen=True)
class Depths:
    """Full scales of the fields of 16 bits of a file.

    Parameters
    ----------
    intensity : int, default 65535
        Value of an intensity of 1.
    colours : int, default 16
        Bits of the colours.
    """

    intensity: int = 65535
    colours: int = 16

    @classmethod
    def of_file(cls, path: Path) -> Self:
        """Return the full scales that a file uses.

        Parameters
        ----------
        path : Path
            A LAS or LAZ file.

        Returns
        -------
        Depths
            They.
        """
        key = file_key(path)
        fields = read_header(path).point_format in (2, 3, 5, 7, 8, 10)
        intensity = EIGHT if 0 < sampled_maximum(key, ("intensity",)) <= EIGHT else 65535
        return cls(intensity, colour_bits(key) if fields else 16)

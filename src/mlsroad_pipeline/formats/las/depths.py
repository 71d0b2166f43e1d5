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

# Number of runs and points per run, evenly spread over the file, that determine the depth.
SAMPLES, SAMPLE_SIZE = 8, 2000
EIGHT = 255


@lru_cache(maxsize=64)
def sampled_maximum(key: FileKey, names: tuple[str, ...]) -> int:
    """Return the maximum of integer fields of a sample spread over the whole file, 0 without points."""
    path = Path(key[0])
    header = read_header(path)
    greatest = 0
    with RecordReader(path, header) as reader:
        for start in spread_starts(header.n_points, SAMPLES, SAMPLE_SIZE):
            records = reader.read(start, start + SAMPLE_SIZE)
            greatest = max(greatest, *(int(records[name].max(initial=0)) for name in names))
    return greatest


def colour_bits(key: FileKey) -> int:
    """Return 8 where the 16-bit colour fields of a file, by its `file_key`, hold colours of 8 bits, else 16."""
    return 8 if 0 < sampled_maximum(key, COLOURS) <= EIGHT else 16


@dataclass(frozen=True)
class Depths:
    """Full scales of the fields of 16 bits of a file."""

    intensity: int = 65535  # value of an intensity of 1
    colours: int = 16  # bits of the colours

    @classmethod
    def of_file(cls, path: Path) -> Self:
        """Return the full scales that a file uses."""
        key = file_key(path)
        fields = read_header(path).point_format in (2, 3, 5, 7, 8, 10)
        intensity = EIGHT if 0 < sampled_maximum(key, ("intensity",)) <= EIGHT else 65535
        return cls(intensity, colour_bits(key) if fields else 16)

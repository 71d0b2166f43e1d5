"""What the files of the inventory share: how they appear, and what is read back from them."""

from __future__ import annotations

import os
import uuid
from abc import abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import shapely
from kedro.io import AbstractDataset

from mlsroad_pipeline.datasets.inventory.road_inventory import MAY_LACK, RoadInventory


@contextmanager
def replaced(target: Path) -> Iterator[Path]:
    """Give the path of a file that takes the place of another when the block ends, and vanishes when it raises.

    Parameters
    ----------
    target : Path
        The file to write, whose folder exists.

    Yields
    ------
    Path
        A path of the same ending, in the same folder, where nothing is.
    """
    temporary = target.with_name(f".{target.stem}-{uuid.uuid4().hex}{target.suffix}")
    try:
        yield temporary
        os.replace(temporary, target)
    finally:
        temporary.unlink(missing_ok=True)


def footprint_text(shapes: np.ndarray) -> np.ndarray:
    """Return footprints as the text that the table of objects has.

    Parameters
    ----------
    shapes : ndarray of shapely Polygon or None, shape (n,)
        The footprints.

    Returns
    -------
    ndarray of str, shape (n,)
        WKT to the centimetre; empty where there is none.
    """
    text = shapely.to_wkt(shapes, rounding_precision=2, trim=False)
    return np.where(shapely.is_missing(shapes), "", text)


def with_empty_text(objects: pd.DataFrame) -> pd.DataFrame:
    """Return a table as it was before `attributes` put NULL in the place of empty text.

    Parameters
    ----------
    objects : DataFrame
        What was read from a file.

    Returns
    -------
    DataFrame
        The same rows.
    """
    kept = pd.DataFrame(objects)
    for name in MAY_LACK:
        kept[name] = kept[name].astype(object).where(kept[name].notna(), "")
    return kept


class InventoryFileDataset(AbstractDataset[RoadInventory, RoadInventory]):
    """An inventory of road objects in a file; a subclass reads and writes it.

    Parameters
    ----------
    filepath : str
        The file.
    metadata : dict, optional
        Anything; not read.
    """

    def __init__(self, *, filepath: str, metadata: dict[str, Any] | None = None) -> None:
        self._filepath = Path(filepath)
        self.metadata = metadata

    @abstractmethod
    def _read(self) -> RoadInventory: ...

    @abstractmethod
    def _write(self, data: RoadInventory) -> None: ...

    def load(self) -> RoadInventory:
        """Read the inventory."""
        return self._read()

    def save(self, data: RoadInventory) -> None:
        """Write the inventory, creating its folder."""
        self._filepath.parent.mkdir(parents=True, exist_ok=True)
        self._write(data)

    def _exists(self) -> bool:
        return self._filepath.is_file()

    def _describe(self) -> dict[str, Any]:
        return {"filepath": str(self._filepath)}

"""Kedro datasets of the road inventory (GeoPackage or GeoParquet), and of the folder of a run of `label`."""

import json
from collections.abc import Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any, NoReturn

from kedro.io import AbstractDataset, DatasetError

from mlsroad_pipeline.execution.parameter_checks import local_path
from mlsroad_pipeline.execution.run_folder import RunFolder
from mlsroad_pipeline.inventory_files.exports import INVENTORY_FORMATS
from mlsroad_pipeline.inventory_files.road_inventory import RoadInventory


class RoadInventoryDataset(AbstractDataset[RoadInventory, RoadInventory]):
    """Inventory of road objects in a GeoPackage or a GeoParquet file.

    A GeoPackage gets the QGIS style of its layer `objects` beside it, with the same name and the extension ``.qml``.
    QGIS applies this style to a GeoParquet file of that name, too.
    """

    def __init__(
        self,
        *,
        filepath: str,
        run: str | None = None,
        background: bool = False,
        metadata: dict[str, Any] | None = None,
    ) -> None:
        self._filepath = local_path(filepath, "filepath")
        self._run = None if run is None else RunFolder(run)
        self.metadata = metadata
        suffix = self._filepath.suffix.lower()
        if suffix not in INVENTORY_FORMATS:
            known = " or ".join(INVENTORY_FORMATS)
            raise DatasetError(f"{filepath}: an inventory needs the extension {known}, got {suffix!r}")
        self._format = INVENTORY_FORMATS[suffix]
        self._background = background
        self._writing: Future[None] | None = None
        self._read: tuple[tuple[int, int, int], RoadInventory] | None = None

    def load(self) -> RoadInventory:
        """Read the inventory; the nodes that load an unchanged file share it, and must not change it."""
        self.finish()
        if not self._filepath.is_file():
            return self._format.read(self._filepath)  # its error names the file
        status = self._filepath.stat()
        state = (status.st_size, status.st_mtime_ns, status.st_ino)
        if self._read is None or self._read[0] != state:
            self._read = state, self._format.read(self._filepath)
        return self._read[1]

    def save(self, data: RoadInventory) -> None:
        """Write the inventory, creating its folder."""
        self.finish()
        if not self._background:
            self._write(data)
            return
        pool = ThreadPoolExecutor(1, "write-inventory")
        self._writing = pool.submit(self._write, data)
        pool.shutdown(wait=False)

    def finish(self) -> None:
        """Wait until the file is written, and raise the error of writing it, once."""
        writing, self._writing = self._writing, None
        if writing is not None:
            writing.result()

    def _write(self, data: RoadInventory) -> None:
        path = self._filepath if self._run is None else self._run.staged(self._filepath)
        path.parent.mkdir(parents=True, exist_ok=True)
        written = self._format.write(data, path)
        if self._run is not None:
            for staged in written:
                self._run.publish(staged)

    @property
    def filepath(self) -> Path:
        """Path of the file, which is written."""
        self.finish()
        return self._filepath

    def _exists(self) -> bool:
        self.finish()
        return self._filepath.is_file()

    def _describe(self) -> dict[str, Any]:
        return {"filepath": str(self._filepath)}


class LabelRunDataset(AbstractDataset[NoReturn, RunFolder]):
    """Handle of the folder of the configured run of `label`, which holds its state and its record."""

    def __init__(self, *, filepath: str, settings: str, metadata: Mapping[str, Any] | None = None) -> None:
        self._run = RunFolder(str(filepath), json.loads(settings))
        self.metadata = metadata

    def load(self) -> RunFolder:
        """Return the handle."""
        return self._run

    def save(self, data: NoReturn) -> None:
        """Raise DatasetError: the folder follows from the parameters."""
        raise DatasetError(f"{self._run.path}: the folder of a run is not saved as a dataset")

    def _exists(self) -> bool:
        return True

    def _describe(self) -> dict[str, Any]:
        return {"filepath": self._run.path}

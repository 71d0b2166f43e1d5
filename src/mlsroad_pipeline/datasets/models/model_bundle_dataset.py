"""A trained model as a folder of plain files, where workers find it."""

from __future__ import annotations

import functools
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from kedro.io import AbstractDataset

from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.datasets.models.bundle_files import load_bundle, save_bundle
from mlsroad_pipeline.execution.task import SourceFile


class ModelBundleDataset(AbstractDataset[ModelBundle, SourceFile]):
    """A model's folder. Saving writes it; loading gives a handle that tasks take as an input and workers read.

    Parameters
    ----------
    filepath : str
        A local folder; it is replaced as a whole.
    metadata : mapping, optional
        Anything; not used.

    Examples
    --------
    In a catalog:

    .. code-block:: yaml

        "{method}.model":
          type: mlsroad_pipeline.datasets.models.model_bundle_dataset.ModelBundleDataset
          filepath: data/06_models/{method}
    """

    def __init__(self, *, filepath: str, metadata: Mapping[str, Any] | None = None) -> None:
        self._folder = Path(filepath)
        self.metadata = metadata

    def load(self) -> SourceFile:
        """Return a handle of the folder."""
        return SourceFile(str(self._folder))

    def save(self, data: ModelBundle) -> None:
        """Write the model beside the old one, then replace it."""
        fresh = self._folder.with_name(f".{self._folder.name}.new")
        shutil.rmtree(fresh, ignore_errors=True)
        save_bundle(data, fresh)
        if self._folder.exists():
            shutil.rmtree(self._folder)
        fresh.rename(self._folder)

    def _exists(self) -> bool:
        return (self._folder / "model.json").is_file()

    def _describe(self) -> dict[str, Any]:
        return {"filepath": str(self._folder)}


def open_model(path: str) -> ModelBundle:
    """Read a model's folder, once per process as long as it stays as it is.

    Parameters
    ----------
    path : str
        The folder.

    Returns
    -------
    ModelBundle
        The model.

    Raises
    ------
    ReadError
        If there is no model, or it is damaged.
    """
    marker = Path(path) / "model.json"
    return _open(path, marker.stat().st_mtime_ns if marker.exists() else 0)


@functools.lru_cache(maxsize=2)
def _open(path: str, modified: int) -> ModelBundle:
    del modified
    return load_bundle(path, check=False)  # the fingerprints of the stages cover its content

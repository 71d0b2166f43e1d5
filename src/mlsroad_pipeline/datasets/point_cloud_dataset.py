"""Kedro dataset of one point cloud in any supported format."""

from __future__ import annotations

from typing import Any

from kedro.io import AbstractDataset, DatasetError

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.execution.path_parameters import local_path
from mlsroad_pipeline.formats.base import ReadOptions, WriteOptions
from mlsroad_pipeline.formats.registry import format_of_name, get_format, known_extensions


class PointCloudDataset(AbstractDataset[PointCloud, PointCloud]):
    """Point cloud in any format of the registry, detected by content on loading and by extension on saving.

    A cloud read from LAS or LAZ is saved with the header, scale, offset and records of that file (see `WriteOptions`).

    Parameters
    ----------
    filepath : str
        The file, on the local file system.
    load_args : dict, optional
        Arguments of `ReadOptions`.
    save_args : dict, optional
        Arguments of `WriteOptions`.
    metadata : dict, optional
        Any metadata; ignored.

    Raises
    ------
    DatasetError
        If an argument is unknown or outside its domain.

    Examples
    --------
    In a catalog:

    .. code-block:: yaml

        street:
          type: mlsroad_pipeline.datasets.point_cloud_dataset.PointCloudDataset
          filepath: data/01_raw/street.laz
          load_args:
            columns: {label: classification}
            coding: {1: unlabelled, 2: road, 6: building}

    In Python:

    >>> import numpy as np, tempfile
    >>> folder = tempfile.TemporaryDirectory()
    >>> dataset = PointCloudDataset(filepath=folder.name + "/street.laz")
    >>> dataset.save(PointCloud(np.array([[1.0, 2.0, 3.0]]), origin=np.array([500000.0, 5400000.0, 0.0])))
    >>> dataset.load().world_xyz().tolist()
    [[500001.0, 5400002.0, 3.0]]
    >>> folder.cleanup()
    """

    def __init__(
        self,
        *,
        filepath: str,
        load_args: dict[str, Any] | None = None,
        save_args: dict[str, Any] | None = None,
        metadata: dict[str, Any] | None = None,
    ) -> None:
        self._path = local_path(filepath, "filepath")
        self.metadata = metadata
        try:
            self._read = ReadOptions.from_config(load_args)
            self._write = WriteOptions.from_config(save_args)
        except ParameterError as error:
            raise DatasetError(f"{filepath}: {error}") from error

    def load(self) -> PointCloud:
        """Read the cloud.

        Returns
        -------
        PointCloud
            All points.

        Raises
        ------
        DatasetError
            If the file cannot be read; the message names the file and the cause.
        """
        return get_format(self._path).read(self._path, self._read)

    def save(self, data: PointCloud) -> None:
        """Write the cloud atomically.

        Parameters
        ----------
        data : PointCloud
            The points.

        Raises
        ------
        DatasetError
            If the extension is unknown or the cloud cannot be stored.
        """
        form = format_of_name(self._path)
        if form is None:
            known = ", ".join(known_extensions())
            raise DatasetError(f"{self._path}: no format with this extension (known: {known})")
        form.write(self._path, data, self._write)

    def _exists(self) -> bool:
        return self._path.is_file()

    def _describe(self) -> dict[str, Any]:
        return {"filepath": str(self._path), "load_args": self._read, "save_args": self._write}

"""Kedro dataset of a trajectory."""

from __future__ import annotations

from typing import Any

from kedro.io import AbstractDataset

from mlsroad_pipeline.algorithms.scenes.trajectory import Trajectory
from mlsroad_pipeline.execution.path_parameters import local_path
from mlsroad_pipeline.surveys.trajectory_files import read_trajectory, write_trajectory


class TrajectoryDataset(AbstractDataset[Trajectory, Trajectory]):
    """Trajectory of a survey vehicle in a text file.

    Parameters
    ----------
    filepath : str
        The file.
    columns : list of str, optional
        Names of the columns, as in `read_trajectory`.
    metadata : dict, optional
        Any metadata; ignored.

    Examples
    --------
    In a catalog::

        trajectory:
          type: mlsroad_pipeline.datasets.trajectory_dataset.TrajectoryDataset
          filepath: data/01_raw/trajectory.csv
    """

    def __init__(
        self, *, filepath: str, columns: list[str] | None = None, metadata: dict[str, Any] | None = None
    ) -> None:
        self._filepath = local_path(filepath, "filepath")
        self._columns = columns
        self.metadata = metadata

    def load(self) -> Trajectory:
        """Read the trajectory."""
        return read_trajectory(self._filepath, columns=self._columns)

    def save(self, data: Trajectory) -> None:
        """Write the trajectory, creating its folder."""
        self._filepath.parent.mkdir(parents=True, exist_ok=True)
        write_trajectory(data, self._filepath)

    def _exists(self) -> bool:
        return self._filepath.is_file()

    def _describe(self) -> dict[str, Any]:
        return {"filepath": str(self._filepath), "columns": self._columns}

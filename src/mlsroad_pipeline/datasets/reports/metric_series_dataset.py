"""A figure that changes from step to step, as a CSV file that hooks log to MLflow."""

from __future__ import annotations

import io

import numpy as np
import pandas as pd

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ReadError
from mlsroad_pipeline.datasets.reports.report_file import ReportFileDataset


class MetricSeriesDataset(ReportFileDataset[pd.DataFrame, pd.DataFrame]):
    """A table of figures by step: the first column holds whole steps, the others one figure each.

    Parameters
    ----------
    filepath : str
        A path or a URL.
    credentials, fs_args, metadata : mapping, optional
        See `ReportFileDataset`.

    Examples
    --------
    In a catalog:

    .. code-block:: yaml

        "{method}.objective":
          type: mlsroad_pipeline.datasets.reports.metric_series_dataset.MetricSeriesDataset
          filepath: data/08_reporting${globals:env_folder}/{method}_objective.csv

    >>> dataset = MetricSeriesDataset(filepath="memory://objective.csv")
    >>> dataset.save(pd.DataFrame({"iteration": [0, 1], "objective": [8.5, 2.25]}))
    >>> dataset.load()["objective"].tolist()
    [8.5, 2.25]
    """

    def load(self) -> pd.DataFrame:
        """Return the table, or raise `DataError` naming the file and what is wrong."""
        try:
            frame = pd.read_csv(io.BytesIO(self.read_bytes()))
        except (pd.errors.ParserError, pd.errors.EmptyDataError, UnicodeDecodeError) as error:
            raise ReadError(f"{self._filepath}: no table of figures by step: {error}") from error
        if frame.empty:  # a file without rows does not tell the kinds of its columns
            frame = frame.astype({name: np.float64 if k else np.int64 for k, name in enumerate(frame)})
        return self._check(frame)

    def save(self, data: pd.DataFrame) -> None:
        """Write the table, or raise `DataError` naming what is wrong."""
        table = self._check(data)
        self.write_bytes(table.to_csv(index=False, lineterminator="\n").encode("utf-8"))

    def _check(self, frame: pd.DataFrame) -> pd.DataFrame:
        kinds = "".join(dtype.kind for dtype in frame.dtypes)
        if len(kinds) < 2 or kinds[0] not in "iu" or not set(kinds) <= set("iuf"):
            raise DataError(f"{self._filepath}: a column of whole steps and columns of numbers, got {list(frame)}")
        return frame

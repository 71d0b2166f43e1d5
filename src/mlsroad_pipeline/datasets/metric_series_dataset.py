"""Kedro dataset of metrics by step as a CSV file, which hooks log to MLflow."""

from __future__ import annotations

import io

import numpy as np
import pandas as pd

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ReadError
from mlsroad_pipeline.datasets.report_file import ReportFileDataset


class MetricSeriesDataset(ReportFileDataset[pd.DataFrame, pd.DataFrame]):
    """Table of metrics by step: integer steps in the first column, one metric in each other column.

    Examples
    --------
    In a catalog:

    .. code-block:: yaml

        "{method}.objective":
          type: mlsroad_pipeline.datasets.metric_series_dataset.MetricSeriesDataset
          filepath: data/08_reporting${globals:env_folder}/{method}_objective.csv

    >>> dataset = MetricSeriesDataset(filepath="memory://objective.csv")
    >>> dataset.save(pd.DataFrame({"iteration": [0, 1], "objective": [8.5, 2.25]}))
    >>> dataset.load()["objective"].tolist()
    [8.5, 2.25]
    """

    def load(self) -> pd.DataFrame:
        """Return the table; raise `ReadError` or `DataError` naming the file and the cause."""
        try:
            frame = pd.read_csv(io.BytesIO(self.read_bytes()))
        except (pd.errors.ParserError, pd.errors.EmptyDataError, UnicodeDecodeError) as error:
            raise ReadError(f"{self._filepath}: no table of metrics by step: {error}") from error
        if frame.empty:  # a file without rows does not determine the types of its columns
            frame = frame.astype({name: np.float64 if k else np.int64 for k, name in enumerate(frame)})
        return self._check(frame)

    def save(self, data: pd.DataFrame) -> None:
        """Write the table; raise `DataError` naming the file and the cause."""
        table = self._check(data)
        self.write_bytes(table.to_csv(index=False, lineterminator="\n").encode("utf-8"))

    def _check(self, frame: pd.DataFrame) -> pd.DataFrame:
        kinds = "".join(dtype.kind for dtype in frame.dtypes)
        if len(kinds) < 2 or kinds[0] not in "iu" or not set(kinds) <= set("iuf"):
            raise DataError(f"{self._filepath}: needs a column of integer steps and numeric columns, got {list(frame)}")
        return frame

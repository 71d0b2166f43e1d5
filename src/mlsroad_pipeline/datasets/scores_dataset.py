"""Kedro dataset of a table of scores as a CSV file, validated on loading and saving."""

from __future__ import annotations

import io

import pandas as pd

from mlsroad_pipeline.algorithms.core.exceptions import ReadError
from mlsroad_pipeline.algorithms.metrics.scores import check_scores
from mlsroad_pipeline.datasets.report_file import ReportFileDataset


class ScoresDataset(ReportFileDataset[pd.DataFrame, pd.DataFrame]):
    """Scores of one method: `method,split,class,metric,value,support`, with empty cells for undefined values.

    Examples
    --------
    In a catalog:

    .. code-block:: yaml

        "{method}.scores":
          type: mlsroad_pipeline.datasets.scores_dataset.ScoresDataset
          filepath: data/08_reporting${globals:env_folder}/scores/{method}.csv

    >>> from mlsroad_pipeline.algorithms.metrics.scores import labelling_scores
    >>> import numpy as np
    >>> table = labelling_scores(np.eye(2, dtype=int), method="demo", split="test", classes=["a", "b"])
    >>> dataset = ScoresDataset(filepath="memory://scores/demo.csv")
    >>> dataset.save(table)
    >>> len(dataset.load())
    12
    """

    def load(self) -> pd.DataFrame:
        """Return the table; raise `ReadError` or `DataError` naming the file and the cause."""
        try:
            # classes may be named "nan" or "None": only an empty cell of `value` is undefined
            frame = pd.read_csv(io.BytesIO(self.read_bytes()), keep_default_na=False, na_values={"value": [""]})
        except (pd.errors.ParserError, pd.errors.EmptyDataError, UnicodeDecodeError) as error:
            raise ReadError(f"{self._filepath}: no table of scores: {error}") from error
        return check_scores(frame, source=self._filepath)

    def save(self, data: pd.DataFrame) -> None:
        """Write the table; raise `DataError` naming the file and the cause."""
        table = check_scores(data, source=self._filepath)
        self.write_bytes(table.to_csv(index=False, lineterminator="\n").encode("utf-8"))

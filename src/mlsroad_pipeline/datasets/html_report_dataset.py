"""Kedro dataset of reports as HTML files."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.datasets.report_file import ReportFileDataset
from mlsroad_pipeline.execution.run_folder import RunFolder
from mlsroad_pipeline.formats.files import atomic_file


class HtmlReportDataset(ReportFileDataset[str, str]):
    """HTML page, such as that of `mlsroad_pipeline.reporting.html.report.build_report`.

    Examples
    --------
    In a catalog:

    .. code-block:: yaml

        report:
          type: mlsroad_pipeline.datasets.html_report_dataset.HtmlReportDataset
          filepath: data/08_reporting${globals:env_folder}/report.html

    >>> dataset = HtmlReportDataset(filepath="memory://report.html")
    >>> dataset.save("<!DOCTYPE html><html></html>")
    >>> dataset.load()
    '<!DOCTYPE html><html></html>'
    """

    def __init__(
        self,
        *,
        filepath: str,
        run: str | None = None,
        credentials: Mapping[str, Any] | None = None,
        fs_args: Mapping[str, Any] | None = None,
        metadata: Mapping[str, Any] | None = None,
    ) -> None:
        super().__init__(filepath=filepath, credentials=credentials, fs_args=fs_args, metadata=metadata)
        self._run = None if run is None else RunFolder(run)

    def load(self) -> str:
        """Return the page."""
        return self.read_bytes().decode("utf-8")

    def save(self, data: str) -> None:
        """Write the page."""
        if not isinstance(data, str) or not data.lstrip().lower().startswith("<!doctype html"):
            raise DataError(f"{self._filepath}: needs an HTML page, got {str(data)[:40]!r}")
        if self._run is None:
            self.write_bytes(data.encode("utf-8"))
            return
        with atomic_file(self._run.staged(self._filepath)) as stream:
            stream.write(data.encode("utf-8"))
        self._run.publish(self._run.staged(self._filepath))

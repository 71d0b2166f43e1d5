"""Kedro dataset of reports as HTML files."""

from __future__ import annotations

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.datasets.reports.report_file import ReportFileDataset


class HtmlReportDataset(ReportFileDataset[str, str]):
    """HTML page, such as that of `mlsroad_pipeline.reporting.html.report.build_report`.

    Parameters
    ----------
    filepath : str
        A path or a URL that ends in ``.html``.
    run : str, optional
        See `ReportFileDataset`.
    credentials, fs_args, metadata : mapping, optional
        See `ReportFileDataset`.

    Raises
    ------
    DataError
        On saving a value that is no HTML page.

    Examples
    --------
    In a catalog:

    .. code-block:: yaml

        report:
          type: mlsroad_pipeline.datasets.reports.html_report_dataset.HtmlReportDataset
          filepath: data/08_reporting${globals:env_folder}/report.html

    >>> dataset = HtmlReportDataset(filepath="memory://report.html")
    >>> dataset.save("<!DOCTYPE html><html></html>")
    >>> dataset.load()
    '<!DOCTYPE html><html></html>'
    """

    def load(self) -> str:
        """Return the page."""
        return self.read_bytes().decode("utf-8")

    def save(self, data: str) -> None:
        """Write the page."""
        if not isinstance(data, str) or not data.lstrip().lower().startswith("<!doctype html"):
            raise DataError(f"{self._filepath}: needs an HTML page, got {str(data)[:40]!r}")
        self.write_bytes(data.encode("utf-8"))

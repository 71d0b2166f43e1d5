"""Kedro datasets of scores, metrics, figures and reports: one small file each, written atomically."""

from __future__ import annotations

import io
import sys
from abc import abstractmethod
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, TypeVar, cast

import fsspec
import numpy as np
import pandas as pd
from fsspec.implementations.local import LocalFileSystem
from kedro.io import AbstractDataset, DatasetError
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ReadError
from mlsroad_pipeline.algorithms.core.plain_text import shortened
from mlsroad_pipeline.algorithms.metrics.scores import check_scores
from mlsroad_pipeline.execution.run_folder import RunFolder
from mlsroad_pipeline.execution.store_files import sync_folder
from mlsroad_pipeline.formats.files import write_atomic

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Saved = TypeVar("Saved")
Loaded = TypeVar("Loaded")


class ReportFileDataset(AbstractDataset[Saved, Loaded], Generic[Saved, Loaded]):
    """File that is read and written as bytes, on any file system of fsspec."""

    def __init__(
        self,
        *,
        filepath: str,
        credentials: Mapping[str, Any] | None = None,
        fs_args: Mapping[str, Any] | None = None,
        metadata: Mapping[str, Any] | None = None,
    ) -> None:
        self._filepath = str(filepath)
        self._options = {**(fs_args or {}), **(credentials or {})}
        self.metadata = metadata

    def read_bytes(self) -> bytes:
        """Return the content of the file; raise `DatasetError` if it does not exist."""
        filesystem, path = fsspec.core.url_to_fs(self._filepath, **self._options)
        try:
            content: bytes = filesystem.cat_file(path)
        except (FileNotFoundError, IsADirectoryError) as error:
            raise DatasetError(f"{self._filepath} does not exist") from error
        return content

    def write_bytes(self, content: bytes, *, suffix: str = "") -> None:
        """Replace the file, or that of another suffix beside it, atomically: by a rename, elsewhere by a single put."""
        place = self._filepath.rpartition(".")[0] + suffix if suffix else self._filepath
        filesystem, path = fsspec.core.url_to_fs(place, **self._options)
        if not isinstance(filesystem, LocalFileSystem):
            filesystem.pipe_file(path, content)
            return
        target = Path(path)
        write_atomic(target, content)
        sync_folder(target.parent)

    @property
    def filename(self) -> str:
        """Name of the file without its folder."""
        return self._filepath.rstrip("/").rsplit("/", 1)[-1]

    def _exists(self) -> bool:
        filesystem, path = fsspec.core.url_to_fs(self._filepath, **self._options)
        return bool(filesystem.isfile(path))

    def _describe(self) -> dict[str, Any]:
        return {"filepath": self._filepath}


class _TableDataset(ReportFileDataset[pd.DataFrame, pd.DataFrame]):
    """CSV table that is checked when it is read and when it is written."""

    what = ""
    """Kind of the table, for messages."""
    read_options: Mapping[str, Any] = {}
    """Further arguments of `pandas.read_csv`."""

    @abstractmethod
    def _check(self, frame: pd.DataFrame) -> pd.DataFrame:
        """Return the table in its types; raise `DataError`."""

    def load(self) -> pd.DataFrame:
        """Return the table; raise `ReadError` or `DataError` naming the file and the cause."""
        try:
            frame = pd.read_csv(io.BytesIO(self.read_bytes()), **self.read_options)
        except (pd.errors.ParserError, pd.errors.EmptyDataError, UnicodeDecodeError) as error:
            raise ReadError(f"{self._filepath}: not a table of {self.what}: {error}") from error
        return self._check(frame)

    def save(self, data: pd.DataFrame) -> None:
        """Write the table; raise `DataError` naming the file and the cause."""
        self.write_bytes(self._check(data).to_csv(index=False, lineterminator="\n").encode("utf-8"))


class ScoresDataset(_TableDataset):
    """Scores of one method: `method,split,class,metric,value,support`, with empty cells for undefined values."""

    what = "scores"
    # classes may be named "nan" or "None": only an empty cell of `value` is undefined
    read_options: Mapping[str, Any] = {"keep_default_na": False, "na_values": {"value": [""]}}

    def _check(self, frame: pd.DataFrame) -> pd.DataFrame:
        return check_scores(frame, source=self._filepath)

    def save_origin(self, text: str) -> None:
        """Write how the table was made, JSON, beside it."""
        self.write_bytes(text.encode("utf-8"), suffix=".json")


class MetricSeriesDataset(_TableDataset):
    """Table of metrics by step: integer steps in the first column, one metric in each other column."""

    what = "metrics by step"

    def _check(self, frame: pd.DataFrame) -> pd.DataFrame:
        if frame.empty:  # a file without rows does not determine the types of its columns
            frame = frame.astype({name: np.float64 if k else np.int64 for k, name in enumerate(frame)})
        kinds = "".join(dtype.kind for dtype in frame.dtypes)
        if len(kinds) < 2 or kinds[0] not in "iu" or not set(kinds) <= set("iuf"):
            raise DataError(f"{self._filepath}: needs a column of integer steps and numeric columns, got {list(frame)}")
        return frame


_EFFORT = 1
"""Compression level of zlib, 0 to 9; pictures of clouds are 5 % larger than at the default of 6, in half the time."""


def _is_figure(data: object) -> bool:
    matplotlib = sys.modules.get("matplotlib.figure")  # a figure exists only if matplotlib has been imported
    return matplotlib is not None and isinstance(data, matplotlib.Figure)


class FigureDataset(ReportFileDataset["Figure | NDArray[np.uint8]", NDArray[np.uint8]]):
    """Matplotlib figure or picture, written as PNG; loading returns the pixels."""

    def __init__(self, *, dpi: float | None = None, **options: Any) -> None:
        super().__init__(**options)
        self._dpi = dpi

    def load(self) -> NDArray[np.uint8]:
        """Return the pixels, uint8 (height, width, 3); raise `ReadError` for a file that is no picture."""
        try:
            return np.asarray(Image.open(io.BytesIO(self.read_bytes())).convert("RGB"))
        except (UnidentifiedImageError, OSError) as error:
            raise ReadError(f"{self._filepath} is not a picture: {error}") from error

    def save(self, data: Figure | NDArray[np.uint8]) -> None:
        """Write the figure or picture; equal pictures give equal bytes."""
        buffer = io.BytesIO()
        if _is_figure(data):
            # the version of matplotlib would change the bytes with every upgrade
            options: dict[str, Any] = {"metadata": {"Software": None}, "pil_kwargs": {"compress_level": _EFFORT}}
            cast("Figure", data).savefig(buffer, format="png", dpi=self._dpi or "figure", **options)
        elif isinstance(data, np.ndarray) and data.dtype == np.uint8 and data.ndim == 3 and data.shape[2] == 3:
            Image.fromarray(data).save(buffer, format="PNG", compress_level=_EFFORT)
        else:
            got = f"{data.dtype} {data.shape}" if isinstance(data, np.ndarray) else type(data).__name__
            raise DataError(f"{self._filepath}: needs a figure or a uint8 array (height, width, 3), got {got}")
        self.write_bytes(buffer.getvalue())


class HtmlReportDataset(ReportFileDataset[str, str]):
    """HTML page, such as that of `mlsroad_pipeline.reporting.html.report.build_report`."""

    def __init__(self, *, run: str | None = None, **options: Any) -> None:
        super().__init__(**options)
        self._run = None if run is None else RunFolder(run)

    @property
    def of_label(self) -> bool:
        """Whether the page is published with the results of a run of `label`, whose record has its origin."""
        return self._run is not None

    def load(self) -> str:
        """Return the page."""
        return self.read_bytes().decode("utf-8")

    def save(self, data: str) -> None:
        """Write the page."""
        if not isinstance(data, str) or not data.lstrip().lower().startswith("<!doctype html"):
            raise DataError(f"{self._filepath}: needs an HTML page, got {shortened(data, 40)!r}")
        if self._run is None:
            self.write_bytes(data.encode("utf-8"))
            return
        write_atomic(self._run.staged(self._filepath), data.encode("utf-8"))
        self._run.publish(self._run.staged(self._filepath))

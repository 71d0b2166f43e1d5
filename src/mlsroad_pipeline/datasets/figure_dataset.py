"""Kedro dataset of figures and pictures as PNG files."""

from __future__ import annotations

import io
import sys
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ReadError
from mlsroad_pipeline.datasets.report_file import ReportFileDataset

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_EFFORT = 1
"""Compression level of zlib, 0 to 9; pictures of clouds are 5 % larger than at the default of 6, in half the time."""


def _is_figure(data: object) -> bool:
    matplotlib = sys.modules.get("matplotlib.figure")  # a figure exists only if matplotlib has been imported
    return matplotlib is not None and isinstance(data, matplotlib.Figure)


class FigureDataset(ReportFileDataset["Figure | NDArray[np.uint8]", NDArray[np.uint8]]):
    """Matplotlib figure or picture, written as PNG; loading returns the pixels.

    Examples
    --------
    In a catalog:

    .. code-block:: yaml

        "{method}.confusion_figure":
          type: mlsroad_pipeline.datasets.figure_dataset.FigureDataset
          filepath: data/08_reporting${globals:env_folder}/figures/{method}_confusion.png

    >>> dataset = FigureDataset(filepath="memory://figures/demo.png")
    >>> dataset.save(np.zeros((4, 6, 3), dtype=np.uint8))
    >>> dataset.load().shape
    (4, 6, 3)
    """

    def __init__(
        self,
        *,
        filepath: str,
        dpi: float | None = None,
        credentials: Mapping[str, Any] | None = None,
        fs_args: Mapping[str, Any] | None = None,
        metadata: Mapping[str, Any] | None = None,
    ) -> None:
        super().__init__(filepath=filepath, credentials=credentials, fs_args=fs_args, metadata=metadata)
        self._dpi = dpi

    def load(self) -> NDArray[np.uint8]:
        """Return the pixels, uint8 (height, width, 3); raise `ReadError` for a file that is no picture."""
        try:
            return np.asarray(Image.open(io.BytesIO(self.read_bytes())).convert("RGB"))
        except (UnidentifiedImageError, OSError) as error:
            raise ReadError(f"{self._filepath} is no picture: {error}") from error

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

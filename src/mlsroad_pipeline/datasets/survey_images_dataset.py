"""Kedro dataset of the images of a survey."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from kedro.io import AbstractDataset, DatasetError

from mlsroad_pipeline.surveys.camera_files import read_images
from mlsroad_pipeline.surveys.images import SurveyImages


class SurveyImagesDataset(AbstractDataset[SurveyImages, SurveyImages]):
    """Images of a survey: cameras and poses; pictures are read on request.

    Parameters
    ----------
    filepath : str
        Description of the cameras; see `camera_files.read_images`.
    images : str, optional
        Folder of the pictures; ``images`` beside the file by default.
    trajectory : str, optional
        Poses of the vehicle, for camera files without poses per image.
    optional : bool, default False
        Treat a missing file as a survey without images; otherwise it is an error.
    metadata : dict, optional
        Any metadata; ignored.

    Examples
    --------
    In a catalog::

        survey_images:
          type: mlsroad_pipeline.datasets.survey_images_dataset.SurveyImagesDataset
          filepath: data/01_raw/survey/calibration.json
    """

    def __init__(
        self, *, filepath: str, images: str | None = None, trajectory: str | None = None, optional: bool = False,
        metadata: dict[str, Any] | None = None,
    ) -> None:  # fmt: skip
        self._filepath, self._images, self._trajectory = filepath, images, trajectory
        self._optional, self.metadata = optional, metadata

    def load(self) -> SurveyImages:
        """Read cameras and poses."""
        if self._optional and not Path(self._filepath).exists():
            return SurveyImages(())
        return read_images(self._filepath, images=self._images, trajectory=self._trajectory)

    def save(self, data: SurveyImages) -> None:
        """Raise DatasetError: images are read-only."""
        raise DatasetError(f"{self._filepath}: images of a survey are read-only and cannot be saved")

    def _exists(self) -> bool:
        return Path(self._filepath).exists()

    def _describe(self) -> dict[str, Any]:
        return {"filepath": self._filepath, "images": self._images, "trajectory": self._trajectory}

"""The images of a survey as a dataset of the catalog."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from kedro.io import AbstractDataset, DatasetError

from mlsroad_pipeline.surveys.camera_files import read_images
from mlsroad_pipeline.surveys.images import SurveyImages


class SurveyImagesDataset(AbstractDataset[SurveyImages, SurveyImages]):
    """The images of a survey; the pictures stay in their files until they are asked for.

    Parameters
    ----------
    filepath : str
        What describes the cameras; see `camera_files.read_images`.
    images : str, optional
        Folder of the pictures; ``images`` beside the file by default.
    trajectory : str, optional
        Poses of the vehicle, for files that give none per image.
    optional : bool, default False
        Whether a missing file means a survey without images instead of an error.
    metadata : dict, optional
        Anything; not read.

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
        """Refuse: images are only read."""
        raise DatasetError(f"images are only read: nothing is saved to {self._filepath}")

    def _exists(self) -> bool:
        return Path(self._filepath).exists()

    def _describe(self) -> dict[str, Any]:
        return {"filepath": self._filepath, "images": self._images, "trajectory": self._trajectory}

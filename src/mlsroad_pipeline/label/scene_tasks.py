"""Tasks that label the scenes of a new survey, with or without images."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from mlsroad_pipeline.algorithms.core.scene_key import SceneKey
from mlsroad_pipeline.algorithms.models.methods import needs_images
from mlsroad_pipeline.algorithms.scenes.binning import BinCounts
from mlsroad_pipeline.algorithms.scenes.corridor import Corridor, corridor_from_arrays
from mlsroad_pipeline.algorithms.scenes.parameters import IngestParameters
from mlsroad_pipeline.execution.collection import SceneCollection
from mlsroad_pipeline.execution.task import SceneTask, SourceFile
from mlsroad_pipeline.label.images import LabelImages, views_of_scene
from mlsroad_pipeline.label.scene import LabelSettings, label_pieces
from mlsroad_pipeline.label.scene_with_images import CameraView, SceneViews, label_pieces_with_images
from mlsroad_pipeline.model_store.bundle_files import ModelFile
from mlsroad_pipeline.surveys.images import PosedImage, SurveyImages
from mlsroad_pipeline.surveys.plan import SurveyPlan
from mlsroad_pipeline.surveys.scene_plan import PlannedScene, pieces_between, plan_drive


def label_tasks(
    plan: SurveyPlan,
    pieces: SceneCollection,
    corridors: SceneCollection,
    model: ModelFile,
    images: LabelImages,
    ingest: IngestParameters,
    settings: LabelSettings,
) -> dict[str, SceneTask]:
    """Create one task per scene, which labels its points."""
    bins, points = pieces.load_all("bins"), pieces.part("points", mapped=True)
    with_images = needs_images(model.load().slug)
    tasks = {}
    for drive, files in plan.drives().items():
        keys = {file.key for file in files}
        near = {key: part for key, part in bins.items() if SceneKey.parse(key).parent in keys}
        corridor = corridor_from_arrays(corridors[drive].load()) if with_images else None
        surroundings = _Surroundings(images.drives.get(drive, SurveyImages(())), images.reach, corridor, ingest)
        for scene in plan_drive(drive, plan, bins, ingest):
            inputs = {"pieces": [points[key] for key in scene.pieces], "model": model}
            parameters = {"span": scene.span, "name": scene.key, "source": scene.source, "settings": settings}
            if not with_images:
                tasks[scene.key] = SceneTask(label_pieces, inputs, parameters)
                continue
            views = surroundings.views(scene)
            tasks[scene.key] = SceneTask(
                label_pieces_with_images,
                inputs
                | {
                    "around": [points[key] for key in surroundings.pieces(scene, near)],
                    "pictures": [SourceFile(str(view.path)) for view in views],
                },
                parameters | {"images": surroundings.scene_views(views)},
            )
    return tasks


@dataclass(frozen=True)
class _Surroundings:
    """Images of a drive and the pieces around its scenes, whose points may occlude a scene in an image."""

    images: SurveyImages
    reach: float
    corridor: Corridor
    ingest: IngestParameters

    @property
    def _corridor(self) -> Corridor:
        return self.corridor if self.ingest.cut == "along" else None

    @property
    def _bins(self) -> int:
        """Bins within reach of a scene; 0 where bins have no position, and without images."""
        if self._corridor is None or len(self.images) == 0:
            return 0
        return int(np.ceil(self.reach / self.ingest.bin_length))

    def pieces(self, scene: PlannedScene, bins: Mapping[str, BinCounts]) -> tuple[str, ...]:
        """Return the keys of the pieces before and behind the buffers of a scene."""
        span = scene.span
        before = pieces_between(span.first - self._bins, span.buffer_first, bins)
        behind = pieces_between(span.buffer_stop, span.stop + self._bins, bins)
        return tuple(dict.fromkeys((*before, *behind)))

    def views(self, scene: PlannedScene) -> tuple[PosedImage, ...]:
        """Return the images that may show a scene."""
        return views_of_scene(
            scene.span, self.images, self._corridor, bin_length=self.ingest.bin_length, reach=self.reach
        )

    def scene_views(self, views: tuple[PosedImage, ...]) -> SceneViews:
        """Return the parameters of the images that show a scene; the pictures themselves are inputs of its task."""
        cameras = tuple(CameraView(view.name, view.group, view.camera) for view in views)
        return SceneViews(cameras, self.images.groups, self.images.origin, self._bins)

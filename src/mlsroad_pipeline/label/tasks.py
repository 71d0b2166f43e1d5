"""The work that labels the scenes of a new survey: from points alone, or from points and images."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.scene_key import SceneKey
from mlsroad_pipeline.algorithms.models.methods import needs_images
from mlsroad_pipeline.algorithms.scenes.corridor import Corridor
from mlsroad_pipeline.algorithms.scenes.cutting import IngestParameters, corridor_from_arrays
from mlsroad_pipeline.datasets.models.bundle_files import ModelFile
from mlsroad_pipeline.execution.collection import SceneCollection
from mlsroad_pipeline.execution.task import SceneTask, SourceFile
from mlsroad_pipeline.label.image_work import label_pieces_through_images
from mlsroad_pipeline.label.images import LabelImages, views_of_scene
from mlsroad_pipeline.label.work import label_pieces
from mlsroad_pipeline.surveys.images import SurveyImages
from mlsroad_pipeline.surveys.plan import SurveyPlan
from mlsroad_pipeline.surveys.scene_plan import PlannedScene, pieces_between, plan_drive


def label_tasks(
    plan: SurveyPlan,
    pieces: SceneCollection,
    corridors: SceneCollection,
    model: ModelFile,
    images: LabelImages,
    ingest: IngestParameters,
    fixed: Mapping[str, Any],
) -> dict[str, SceneTask]:
    """Name the work that labels each scene."""
    bins, points = pieces.load_all("bins"), pieces.part("points", mapped=True)
    through_images = needs_images(model.load().slug)
    tasks = {}
    for drive in plan.drives():
        mine = {file.key for file in plan.files if file.drive == drive}
        near = {key: part for key, part in bins.items() if SceneKey.parse(key).parent in mine}
        shown = _Shown(images, drive, corridor_from_arrays(corridors[drive].load()), ingest) if through_images else None
        for scene in plan_drive(drive, plan, bins, ingest):
            inputs = {"pieces": [points[key] for key in scene.pieces], "model": model}
            parameters = {"span": scene.span, "name": scene.key, "source": scene.source, **fixed}
            if shown is None:
                tasks[scene.key] = SceneTask(label_pieces, inputs, parameters)
                continue
            around = [points[key] for key in shown.around(scene, near)]
            more, told = shown.inputs(scene)
            tasks[scene.key] = SceneTask(
                label_pieces_through_images, {**inputs, "around": around, **more}, {**parameters, **told}
            )
    return tasks


@dataclass(frozen=True)
class _Shown:
    """What images show of a drive."""

    images: LabelImages
    drive: str
    corridor: Corridor
    ingest: IngestParameters

    @property
    def own(self) -> SurveyImages:
        return self.images.drives.get(self.drive, SurveyImages(()))

    @property
    def reach(self) -> int:
        """Bins beyond a scene whose points may hide its own; where bins are no places, there are none."""
        placed = self.corridor is not None and self.ingest.cut == "along" and len(self.own) > 0
        return int(np.ceil(self.images.reach / self.ingest.bin_length)) if placed else 0

    def around(self, scene: PlannedScene, bins: Mapping[str, Mapping[str, NDArray]]) -> tuple[str, ...]:
        """Name the pieces before and behind a scene's buffers."""
        span = scene.span
        before = pieces_between(span.first - self.reach, span.buffer_first, bins)
        behind = pieces_between(span.buffer_stop, span.stop + self.reach, bins)
        return tuple(dict.fromkeys((*before, *behind)))

    def inputs(self, scene: PlannedScene) -> tuple[dict[str, Any], dict[str, Any]]:
        """Return the pictures that may show a scene, and what is told about them."""
        placed = self.corridor if self.ingest.cut == "along" else None
        views = views_of_scene(
            scene.span, self.own, placed, bin_length=self.ingest.bin_length, reach=self.images.reach
        )  # fmt: skip
        told = {
            "views": [(view.name, view.group, view.camera) for view in views],
            "cameras": self.own.groups,
            "origin": self.own.origin,
            "reach": self.reach,
        }
        return {"pictures": [SourceFile(str(view.path)) for view in views]}, told

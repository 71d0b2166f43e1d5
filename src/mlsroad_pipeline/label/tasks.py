"""Tasks that label the scenes of a survey, and the files to write with the labels of their points."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.scene_key import SceneKey
from mlsroad_pipeline.algorithms.models.methods import needs_images
from mlsroad_pipeline.algorithms.scenes.binning import BinCounts
from mlsroad_pipeline.algorithms.scenes.corridor import Corridor, corridor_from_arrays
from mlsroad_pipeline.algorithms.scenes.parameters import IngestParameters
from mlsroad_pipeline.execution.collection import SceneCollection
from mlsroad_pipeline.execution.run_folder import RunFolder
from mlsroad_pipeline.execution.task import Deferred, SceneTask, SourceFile, StoredResult
from mlsroad_pipeline.formats.base import ReadOptions
from mlsroad_pipeline.label.alignment import PassMove
from mlsroad_pipeline.label.images import CameraView, LabelImages, SceneViews, label_pieces_with_images, views_of_scene
from mlsroad_pipeline.label.inventory import OBJECTS, scenes_of
from mlsroad_pipeline.label.runs import paths_of
from mlsroad_pipeline.label.scene import LabelSettings, label_pieces
from mlsroad_pipeline.model_store.bundle_files import ModelFile
from mlsroad_pipeline.surveys.images import PosedImage, SurveyImages
from mlsroad_pipeline.surveys.parameters import LabelParameters
from mlsroad_pipeline.surveys.plan import PlannedFile, PlannedScene, SurveyPlan, pieces_between, plan_pass
from mlsroad_pipeline.surveys.reading import FileClasses


def label_tasks(
    plan: SurveyPlan,
    pieces: SceneCollection,
    corridors: SceneCollection,
    model: ModelFile,
    images: LabelImages,
    ingest: IngestParameters,
    settings: LabelSettings,
    moves: Mapping[str, tuple[PassMove, ...]],
) -> dict[str, SceneTask]:
    """Create one task per scene, which labels its points; `moves` are those of the files of each pass."""
    bins, points = pieces.load_all("bins"), pieces.part("points", mapped=True)
    with_images = needs_images(model.load().slug)
    tasks = {}
    for pass_key, files in plan.passes().items():
        keys, own = {file.key for file in files}, replace(settings, moves=moves.get(pass_key, ()))
        near = {key: part for key, part in bins.items() if SceneKey.parse(key).parent in keys}
        corridor = corridor_from_arrays(corridors[pass_key].load()) if with_images else None
        surroundings = _Surroundings(images.passes.get(pass_key, SurveyImages(())), images.reach, corridor, ingest)
        for scene in plan_pass(pass_key, plan, bins, ingest):
            inputs = {"pieces": [points[key] for key in scene.pieces], "model": model}
            parameters = {"span": scene.span, "name": scene.key, "source": scene.source, "settings": own}
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
    """Images of a pass and the pieces around its scenes, whose points may occlude a scene in an image."""

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


WRITING_THREADS = 2


@dataclass(frozen=True)
class PlannedOutput:
    """A labelled file to write."""

    file: PlannedFile  # File of the survey
    paths: tuple[str, ...]  # Paths of the results, of `targets.paths_of`: the LAZ first
    scenes: Deferred  # Labels of the scenes that hold its points
    objects: Mapping[str, StoredResult]  # Numbers and classes of the objects: inputs of `work.write_file`
    rows: NDArray[np.int64]  # First and last row of the file in each scene
    had_classes: bool | None  # Whether a LAS file has classes other than 0; None if unknown

    @property
    def inputs(self) -> dict[str, Any]:
        """Inputs of `work.write_file`."""
        return {"path": SourceFile(self.file.source.path), "scenes": self.scenes, **self.objects}

    def parameters(
        self,
        options: ReadOptions,
        run: RunFolder,
        label: LabelParameters,
        *,
        codes: NDArray[np.uint8],
        class_names: Mapping[int, str],
    ) -> dict[str, Any]:
        """Return the parameters of `work.write_file`; `class_names` are the names of the codes."""
        return {
            "codes": codes,
            "rows": self.rows,
            "file": self.file.number,
            "target": self.paths[0],
            "run": run,
            "options": options,
            "n_threads": WRITING_THREADS,
            "had_classes": self.had_classes,
            "copc": label.copc,
            "coloured_ply": label.coloured_ply,
            "class_names": class_names,
        }


def _had_classes(file: PlannedFile, classes: Mapping[str, FileClasses]) -> bool | None:
    ranges = [part["has_classes"] for key, part in classes.items() if SceneKey.parse(key).parent == file.key]
    return bool(np.any(np.concatenate(ranges))) if ranges and all(map(len, ranges)) else None


def planned_outputs(
    plan: SurveyPlan,
    pieces: SceneCollection,
    results: SceneCollection,
    joined: SceneCollection,
    run: RunFolder,
    parameters: LabelParameters,
) -> list[PlannedOutput]:
    """Return the files to write."""
    spans = results.load_all("spans")
    labels = results.part("labels")
    classes = pieces.load_all("classes")
    objects = {name: joined.part(name, mapped=True)[OBJECTS] for name in ("numbers", "classes")}
    outputs: list[PlannedOutput] = []
    for file in plan.files:
        scenes, rows = [], []
        for key in scenes_of(file.pass_key, results):
            lines = spans[key]["spans"]
            for first, last in lines[lines[:, 0] == file.number, 1:]:
                scenes.append(labels[key])
                rows.append((first, last))
        of_file = np.array(rows, dtype=np.int64).reshape(-1, 2)
        paths = paths_of(file, run.output, parameters)
        known = _had_classes(file, classes)
        outputs.append(PlannedOutput(file, paths, Deferred(tuple(scenes)), objects, of_file, known))
    return outputs

"""Files to write, each with the labels of its points."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.scene_key import SceneKey
from mlsroad_pipeline.execution.collection import SceneCollection
from mlsroad_pipeline.execution.run_folder import RunFolder
from mlsroad_pipeline.execution.task import Deferred, SourceFile, StoredResult
from mlsroad_pipeline.formats.options import ReadOptions
from mlsroad_pipeline.label.inventory import OBJECTS, scenes_of
from mlsroad_pipeline.label.targets import paths_of
from mlsroad_pipeline.surveys.parameters import LabelParameters
from mlsroad_pipeline.surveys.plan import PlannedFile, SurveyPlan
from mlsroad_pipeline.surveys.reading import FileClasses

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
        for key in scenes_of(file.drive, results):
            lines = spans[key]["spans"]
            for first, last in lines[lines[:, 0] == file.number, 1:]:
                scenes.append(labels[key])
                rows.append((first, last))
        of_file = np.array(rows, dtype=np.int64).reshape(-1, 2)
        paths = paths_of(file, run.output, parameters)
        known = _had_classes(file, classes)
        outputs.append(PlannedOutput(file, paths, Deferred(tuple(scenes)), objects, of_file, known))
    return outputs

"""Outputs of `label`: plan of the files to write, sections of the report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.scene_key import SceneKey
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle, bundle_scheme, model_source
from mlsroad_pipeline.algorithms.models.methods import needs_images
from mlsroad_pipeline.execution.collection import SceneCollection
from mlsroad_pipeline.execution.task import Deferred
from mlsroad_pipeline.formats.las.copc import copc_path
from mlsroad_pipeline.formats.options import ReadOptions
from mlsroad_pipeline.formats.ply.coloured_ply import coloured_path
from mlsroad_pipeline.label.confidence import confidence_table, confidence_warnings
from mlsroad_pipeline.label.images import effect_without_images
from mlsroad_pipeline.label.inventory import scenes_of
from mlsroad_pipeline.label.scene import LabelCounts
from mlsroad_pipeline.label.summary import class_counts, summed_counts, written_clouds
from mlsroad_pipeline.label.work import WrittenFile
from mlsroad_pipeline.reporting.html.report import Section
from mlsroad_pipeline.reporting.html.sections import (
    DistributionSection,
    FactsSection,
    InventorySection,
    TableSection,
    WarningsSection,
)
from mlsroad_pipeline.surveys.parameters import LabelParameters
from mlsroad_pipeline.surveys.plan import PlannedFile, SurveyPlan
from mlsroad_pipeline.surveys.reading import FileClasses

WRITING_THREADS = 2
_NOT_LISTED = ("scene", "method", "model_version", "footprint")  # columns of the inventory that the report omits
CONFIDENCE_NOTE = (
    "Probability of the class assigned to a point. There is a warning above if a fifth of all points, or half of the "
    "points of a class, are below 0.5."
)


@dataclass(frozen=True)
class PlannedOutput:
    """A labelled file to write.

    Parameters
    ----------
    file : PlannedFile
        File of the survey.
    target : str
        Path of the LAZ file.
    scenes : Deferred
        Labels of the scenes that hold its points.
    rows : ndarray of int64, shape (m, 2)
        First and last row of the file in each scene.
    had_classes : bool or None
        Whether a LAS file has classes other than 0; None if unknown.
    copc : bool, default False
        Whether to write a cloud-optimised copy.
    coloured_ply : bool, default False
        Whether to write a PLY with class colours.
    class_names : mapping of int to str, optional
        Names of the codes.
    """

    file: PlannedFile
    target: str
    scenes: Deferred
    rows: NDArray[np.int64]
    had_classes: bool | None
    copc: bool = False
    coloured_ply: bool = False
    class_names: Mapping[int, str] | None = None

    @property
    def written(self) -> tuple[str, ...]:
        """Paths that must exist for the output to be complete."""
        copies = [copc_path(self.target)] * self.copc + [coloured_path(self.target)] * self.coloured_ply
        return (self.target, *copies)

    def parameters(self, options: ReadOptions) -> dict[str, Any]:
        """Return the parameters of `work.write_file`."""
        return {
            "rows": self.rows,
            "file": self.file.number,
            "target": self.target,
            "options": options,
            "n_threads": WRITING_THREADS,
            "had_classes": self.had_classes,
            "copc": self.copc,
            "coloured_ply": self.coloured_ply,
            "class_names": self.class_names,
        }


def _had_classes(file: PlannedFile, classes: Mapping[str, FileClasses]) -> bool | None:
    ranges = [part["has_classes"] for key, part in classes.items() if SceneKey.parse(key).parent == file.key]
    return bool(np.any(np.concatenate(ranges))) if ranges and all(map(len, ranges)) else None


def planned_outputs(
    plan: SurveyPlan, pieces: SceneCollection, results: SceneCollection, folder: str, **settings: Any
) -> list[PlannedOutput]:
    """Return the files to write; subfolders are mirrored."""
    spans = results.load_all("spans")
    labels = results.part("labels")
    classes = pieces.load_all("classes")
    outputs: list[PlannedOutput] = []
    taken: dict[str, str] = {}
    for file in plan.files:
        name = PurePosixPath(file.source.name)
        stem = name.name[: -len(".gz")] if name.name.lower().endswith(".gz") else name.name
        stem = PurePosixPath(stem).stem.removesuffix(".copc")  # the result is not in the order of an octree
        target = str(Path(folder) / name.parent / f"{stem}.laz")
        if target in taken:
            raise ParameterError(f"{taken[target]} and {file.source.name} would both be written to {target}")
        taken[target] = file.source.name
        scenes, rows = [], []
        for key in scenes_of(file.drive, results):
            lines = spans[key]["spans"]
            for first, last in lines[lines[:, 0] == file.number, 1:]:
                scenes.append(labels[key])
                rows.append((first, last))
        outputs.append(
            PlannedOutput(
                file,
                target,
                Deferred(tuple(scenes)),
                np.array(rows, dtype=np.int64).reshape(-1, 2),
                _had_classes(file, classes),
                **settings,
            )
        )
    return outputs


def _plain_text(value: object) -> str:
    """Return a mapping as ``name value, name value``, anything else as its string."""
    return ", ".join(f"{name} {item}" for name, item in value.items()) if isinstance(value, Mapping) else str(value)


def label_warnings(bundle: ModelBundle, counts: Mapping[str, LabelCounts]) -> list[str]:
    """Return the warnings about the labels and the images."""
    confidences = confidence_table(summed_counts(counts)["confidences"], bundle_scheme(bundle).classes)
    return [*confidence_warnings(confidences), *image_warnings(bundle, counts)]


def label_report_sections(
    bundle: ModelBundle,
    parameters: LabelParameters,
    quality: pd.DataFrame,
    counts: Mapping[str, LabelCounts],
    written: Mapping[str, WrittenFile],
    objects: pd.DataFrame,
    warnings: Sequence[str],
) -> list[Section]:
    """Return the sections of the report."""
    scheme = bundle_scheme(bundle)
    total = summed_counts(counts)
    facts = {
        "survey": parameters.survey_name,
        "output": parameters.output,
        "model": _plain_text(model_source(bundle)),
        "trained on": _plain_text(bundle.metadata.get("trained_on", "")),
        "codes": parameters.scheme,
        "files": len(quality),
        "points": int(quality["n_points"].sum()),
    }
    facts |= _seen_by_cameras(bundle, counts)
    return [
        FactsSection("Run", facts),
        WarningsSection("Warnings", list(warnings)),
        DistributionSection("Classes", class_counts(bundle, total), scheme=scheme),
        TableSection("Confidence", confidence_table(total["confidences"], scheme.classes), note=CONFIDENCE_NOTE),
        InventorySection("Inventory", objects.drop(columns=list(_NOT_LISTED)), geopackage="inventory.gpkg"),
        TableSection("Quality of the survey", quality),
        TableSection("Files written", pd.DataFrame({"file": written_clouds(written)})),
    ]


def _seen_by_cameras(bundle: ModelBundle, counts: Mapping[str, LabelCounts]) -> dict[str, str]:
    """Return the number and share of points in an image, for methods that use images."""
    if not needs_images(bundle.slug):
        return {}
    total = sum(int(scene["counts"].sum()) for scene in counts.values())
    seen = sum(int(scene["seen"][0]) for scene in counts.values() if "seen" in scene)
    return {"seen by cameras": f"{seen} points, {100 * seen / max(total, 1):.1f} %"}


def image_warnings(bundle: ModelBundle, counts: Mapping[str, LabelCounts]) -> list[str]:
    """Return a warning for drives without images, for methods that use images."""
    without = list(dict.fromkeys(SceneKey.parse(key).parent for key, scene in counts.items() if "seen" not in scene))
    if not needs_images(bundle.slug) or not without:
        return []
    return [f"There are no images for {', '.join(without)}: {effect_without_images(bundle)}."]

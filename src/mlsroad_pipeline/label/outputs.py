"""What `label` makes of its scenes' results: the plan of what is written, the report."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.scene_key import SceneKey
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle, bundle_scheme, missing_attributes
from mlsroad_pipeline.algorithms.models.methods import needs_images
from mlsroad_pipeline.execution.collection import SceneCollection
from mlsroad_pipeline.execution.task import Deferred
from mlsroad_pipeline.formats.las.copc import copc_path
from mlsroad_pipeline.formats.options import ReadOptions
from mlsroad_pipeline.formats.ply.coloured_ply import coloured_path
from mlsroad_pipeline.label.confidence import confidence_table, confidence_warnings
from mlsroad_pipeline.label.images import IMAGE_LABELS
from mlsroad_pipeline.label.inventory import OBJECTS, scenes_of
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

logger = logging.getLogger(__name__)

WRITING_THREADS = 2
_ELSEWHERE = ("scene", "method", "model_version", "footprint")  # what the report's list of objects leaves to the files
CONFIDENCE_NOTE = (
    "The probability that the model gives to the class of a point. Where a fifth of all points lie below 0.5, or half "
    "of a class, there is a warning above."
)


@dataclass(frozen=True)
class PlannedOutput:
    """A file that is written with the labels of its points.

    Parameters
    ----------
    file : PlannedFile
        The file of the survey.
    target : str
        The LAZ file.
    scenes : Deferred
        The labels of the scenes that hold its points.
    rows : ndarray of int64, shape (m, 2)
        First and last row of the file in each of them.
    had_classes : bool or None
        Whether a LAS file has classes other than 0, where that is known.
    copc : bool, default False
        Whether a cloud-optimised copy is written beside the LAZ.
    coloured_ply : bool, default False
        Whether a PLY in the colours of the classes is written beside the LAZ.
    """

    file: PlannedFile
    target: str
    scenes: Deferred
    rows: NDArray[np.int64]
    had_classes: bool | None
    copc: bool = False
    coloured_ply: bool = False

    @property
    def written(self) -> tuple[str, ...]:
        """Files that must be there for the output to count as written."""
        copies = [copc_path(self.target)] * self.copc + [coloured_path(self.target)] * self.coloured_ply
        return (self.target, *copies)

    def parameters(self, options: ReadOptions) -> dict[str, Any]:
        """Return the parameters of `label_work.write_file`."""
        return {
            "rows": self.rows,
            "file": self.file.number,
            "target": self.target,
            "options": options,
            "n_threads": WRITING_THREADS,
            "had_classes": self.had_classes,
            "copc": self.copc,
            "coloured_ply": self.coloured_ply,
        }


def _had_classes(file: PlannedFile, classes: Mapping[str, Mapping[str, NDArray]]) -> bool | None:
    found = [part["has_classes"] for key, part in classes.items() if SceneKey.parse(key).parent == file.key]
    return bool(np.any(np.concatenate(found))) if found and all(map(len, found)) else None


def planned_outputs(
    plan: SurveyPlan, pieces: SceneCollection, results: SceneCollection, folder: str, **copies: bool
) -> list[PlannedOutput]:
    """Plan what is written where; subfolders are mirrored."""
    spans = results.load_all("spans")
    labels = results.part("labels")
    classes = pieces.load_all("classes")
    outputs: list[PlannedOutput] = []
    taken: dict[str, str] = {}
    for file in plan.files:
        name = PurePosixPath(file.source.name)
        stem = name.name[: -len(".gz")] if name.name.lower().endswith(".gz") else name.name
        stem = PurePosixPath(stem).stem.removesuffix(".copc")  # the result is in the survey's order, not an octree's
        target = str(Path(folder) / name.parent / f"{stem}.laz")
        if target in taken:
            raise ParameterError(f"{taken[target]} and {file.source.name} would both be written to {target}")
        taken[target] = file.source.name
        chosen, rows = [], []
        for key in scenes_of(file.drive, results):
            found = spans[key]["spans"]
            for number, first, last in found[found[:, 0] == file.number]:
                del number
                chosen.append(labels[key])
                rows.append((first, last))
        outputs.append(
            PlannedOutput(
                file,
                target,
                Deferred(tuple(chosen)),
                np.array(rows, dtype=np.int64).reshape(-1, 2),
                _had_classes(file, classes),
                **copies,
            )
        )
    return outputs


def _in_words(told: object) -> str:
    """Write names and values without the marks of a programming language."""
    return ", ".join(f"{name} {value}" for name, value in told.items()) if isinstance(told, Mapping) else str(told)


def label_report_sections(
    bundle: ModelBundle,
    parameters: LabelParameters,
    quality: pd.DataFrame,
    counts: Mapping[str, Mapping[str, NDArray]],
    written: Mapping[str, Mapping[str, NDArray]],
    objects: pd.DataFrame,
) -> list[Section]:
    """Compose the report of a labelled survey."""
    scheme = bundle_scheme(bundle)
    total = np.sum([found["counts"] for found in counts.values()], axis=0)
    sureness = confidence_table(np.sum([found["confidences"] for found in counts.values()], axis=0), scheme.classes)
    unsure = confidence_warnings(sureness)
    for warning in unsure:
        logger.warning(warning)
    facts = {
        "survey": parameters.survey,
        "output": parameters.output,
        "model": _in_words(bundle.metadata.get("registered", bundle.slug)),
        "trained on": _in_words(bundle.metadata.get("trained_on", "")),
        "codes": parameters.scheme,
        "files": len(quality),
        "points": int(quality["n_points"].sum()),
    }
    facts |= _seen_by_cameras(bundle, counts)
    outputs = pd.DataFrame({"file": [str(n) for key, part in written.items() if key != OBJECTS for n in part["files"]]})
    shares = dict(zip((*scheme.classes, "unlabelled"), total.tolist(), strict=True))
    return [
        FactsSection("What was run", facts),
        WarningsSection("Warnings", [*unsure, *image_warnings(bundle, counts), *_warnings(bundle, quality)]),
        DistributionSection("Classes", shares, scheme=scheme),
        TableSection("Confidence", sureness, note=CONFIDENCE_NOTE),
        InventorySection("Inventory", objects.drop(columns=list(_ELSEWHERE)), geopackage="inventory.gpkg"),
        TableSection("Quality of the survey", quality),
        TableSection("Files written", outputs),
    ]


def _seen_by_cameras(bundle: ModelBundle, counts: Mapping[str, Mapping[str, NDArray]]) -> dict[str, str]:
    """Tell which share of the points cameras saw, of methods that look at images."""
    if not needs_images(bundle.slug):
        return {}
    total = sum(int(found["counts"].sum()) for found in counts.values())
    seen = sum(int(found["seen"][0]) for found in counts.values() if "seen" in found)
    return {"seen by cameras": f"{seen} points, {100 * seen / max(total, 1):.1f} %"}


def image_warnings(bundle: ModelBundle, counts: Mapping[str, Mapping[str, NDArray]]) -> list[str]:
    """Say which drives were labelled without images by a method that looks at images."""
    without = list(dict.fromkeys(SceneKey.parse(key).parent for key, found in counts.items() if "seen" not in found))
    if not needs_images(bundle.slug) or not without:
        return []
    instead = "have no class" if bundle.slug == IMAGE_LABELS else "have the labels of the features alone"
    return [f"There are no images for {', '.join(without)}: the points there {instead}."]


def attribute_warnings(bundle: ModelBundle, quality: pd.DataFrame) -> list[str]:
    """Say which files lack what the model was trained with."""
    found = []
    for row in quality.to_dict("records"):
        have = [str(name).removeprefix("has_") for name, value in row.items() if str(name).startswith("has_") and value]
        absent = missing_attributes(bundle, have)
        if absent:
            found.append(
                f"{row['source']} has no {' and no '.join(absent)}: the model, which was trained with it, does without."
            )
    return found


def _warnings(bundle: ModelBundle, quality: pd.DataFrame) -> list[str]:
    found = attribute_warnings(bundle, quality)
    for row in quality.to_dict("records"):
        if row["n_duplicates"]:
            found.append(f"{row['source']} has {row['n_duplicates']} points that repeat another one exactly.")
        if row["n_gaps"]:
            found.append(
                f"{row['source']} has {row['n_gaps']} gaps in time, the longest of {row['longest_gap']:.1f} s."
            )
    return found

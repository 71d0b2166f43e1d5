"""Inventory of a survey to label, and its copies in the formats of `label.export`."""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import pandas as pd
from pyproj import CRS

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError, ReadError
from mlsroad_pipeline.algorithms.core.scene_key import SceneKey
from mlsroad_pipeline.algorithms.inventory.lines.layers import LINE_KINDS
from mlsroad_pipeline.algorithms.inventory.lines.markings.marking_lines import paved_classes
from mlsroad_pipeline.algorithms.inventory.objects.rules import KIND_OF_CLASS, KINDS, ObjectRule
from mlsroad_pipeline.algorithms.inventory.objects.sections import line_lengths, section_table
from mlsroad_pipeline.algorithms.inventory.objects.table import lasting_keys
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle, bundle_scheme, model_source
from mlsroad_pipeline.algorithms.scenes.corridor import corridor_from_arrays
from mlsroad_pipeline.algorithms.scenes.trajectory import Trajectory
from mlsroad_pipeline.execution.collection import SceneCollection
from mlsroad_pipeline.execution.run_folder import RunFolder
from mlsroad_pipeline.execution.task import Deferred, SceneTask
from mlsroad_pipeline.formats.files import WRONG
from mlsroad_pipeline.inventory_files.exports import EXPORTS
from mlsroad_pipeline.inventory_files.road_inventory import RoadInventory, line_vertices
from mlsroad_pipeline.label.joined_objects import join_objects
from mlsroad_pipeline.model_store.bundle_files import ModelFile
from mlsroad_pipeline.model_store.object_classifiers import classifier_digest
from mlsroad_pipeline.review.corrections.edited_inventory import system_of
from mlsroad_pipeline.review.corrections.inventory_columns import corrected_table
from mlsroad_pipeline.review.corrections.listed_objects import read_objects
from mlsroad_pipeline.surveys.parameters import LabelParameters
from mlsroad_pipeline.surveys.plan import SurveyPlan
from mlsroad_pipeline.surveys.reading import check_one_crs

logger = logging.getLogger(__name__)

Inventory: TypeAlias = RoadInventory
"""Inventory of a survey, as nodes pass it on."""

OBJECTS = "inventory"
"""Key of the joined objects in their store."""


def scenes_of(pass_key: str, results: SceneCollection) -> list[str]:
    """Return the keys of a pass's scenes."""
    return [key for key in results if SceneKey.parse(key).parent == pass_key]


def objects_task(
    plan: SurveyPlan,
    corridors: SceneCollection,
    results: SceneCollection,
    rules: Mapping[str, ObjectRule],
    model: ModelFile,
    parameters: LabelParameters,
) -> SceneTask:
    """Return the task that joins the objects of all scenes of a survey."""
    bundle = model.load()
    passes = {pass_key: scenes_of(pass_key, results) for pass_key in plan.passes()}
    parts: dict[str, Any] = {
        name: {pass_key: Deferred(tuple(stored[key] for key in keys)) for pass_key, keys in passes.items()}
        for name in ("objects", "fragments", "evidence", "kerbs", "wires", "barriers", "markings")
        for stored in [results.part(name)]
    }
    parts["sightings"] = Deferred(tuple(results.part("sightings").values()))
    source, scheme = model_source(bundle), bundle_scheme(bundle)
    labels = {name: label for label, name in enumerate(scheme.classes)}
    version = f"{source['name']} {source['version']}".strip() if "source" in source else ""
    return SceneTask(
        join_objects,
        {"corridors": {pass_key: corridors[pass_key] for pass_key in passes}, **parts, "model": model},
        {
            "rules": dict(rules),
            "labels": labels,
            "classifier": classifier_digest(),
            "least_score": parameters.least_scores,
            "least_kerb": parameters.least_kerb,
            "least_marking": parameters.least_marking,
            "join_drives": parameters.join_drives,
            "within": parameters.within,
            "method": bundle.slug,
            "model_version": version,
        },
    )


def survey_crs(plan: SurveyPlan, files: SceneCollection) -> str | None:
    """Return the coordinate reference system of a survey, which all of its files share."""
    samples = files.part("sample")
    systems = [(file.source.name, samples[file.key].load().crs) for file in plan.files]
    check_one_crs(systems)
    return systems[0][1]


def marking_warnings(
    plan: SurveyPlan, files: SceneCollection, bundle: ModelBundle, parameters: LabelParameters
) -> list[str]:
    """Return a warning for each reason that the inventory has no road markings."""
    if parameters.markings is None:
        return []
    has_paved = paved_classes(bundle_scheme(bundle)).any()
    reasons = [] if has_paved else ["the model has no class of paved ground"]
    reasons += [] if has_intensity(plan, files) else ["the survey has no intensity"]
    return [f"No road markings are listed: {reason}" for reason in reasons]


def check_paths(corridors: SceneCollection, parameters: LabelParameters) -> None:
    """Raise an error if objects shall be listed near the path, and a pass has none."""
    for pass_key in corridors if parameters.within is not None else ():
        if not isinstance(corridor_from_arrays(corridors[pass_key].load()), Trajectory):
            name = pass_key.rpartition(".")[2]
            raise ParameterError(
                f"label.within {parameters.within:g} m: {'the survey' if name == '_' else name} has no path: put a "
                "trajectory beside the points, or leave it out"
            )


def has_intensity(plan: SurveyPlan, files: SceneCollection) -> bool:
    """Return whether the points of any file have different intensities."""
    samples = files.part("sample")
    for file in plan.files:
        values = samples[file.key].load().get("intensity")
        known = np.zeros(0) if values is None else values[np.isfinite(values)]
        if len(np.unique(known)) > 1:
            return True
    return False


def inventory_of(
    plan: SurveyPlan,
    files: SceneCollection,
    corridors: SceneCollection,
    joined: SceneCollection,
    parameters: LabelParameters,
    output: Path,
) -> RoadInventory:
    """Return the inventory of a survey, with its trajectory and sections if it has a single one.

    Decisions of an earlier inventory in the output folder are transferred.
    """
    passes = list(plan.passes())
    corridor = corridor_from_arrays(corridors[passes[0]].load()) if len(passes) == 1 else None
    trajectory = corridor if isinstance(corridor, Trajectory) else None
    crs = survey_crs(plan, files)
    found = joined.part("objects")[OBJECTS].load()
    earlier = [] if parameters.keys_from is None else [_keys_of_survey(Path(parameters.keys_from), crs)]
    found["key"] = lasting_keys(found, *earlier, _with_keys(read_objects(output).table), crs=crs)
    if earlier and not found["key"].isin(earlier[0]["key"]).any():
        logger.warning("label.keys_from: no object stands where one of %s does: no key is taken", parameters.keys_from)
    objects = corrected_table(found, output)
    given = None if parameters.sections is None else read_sections(Path(parameters.sections))
    if given is not None and trajectory is None:
        logger.warning("label.sections is not used: the survey has no path with stations")
    sections = None if trajectory is None else section_table(objects, trajectory.length, sections=given)
    lines = joined.part("lines")[OBJECTS].load()
    if sections is not None and trajectory is not None:
        for kind in LINE_KINDS:
            of_kind = line_vertices(lines[lines["kind"] == kind])
            sections[f"{kind}_length"] = line_lengths(of_kind, trajectory, sections)
    return RoadInventory(objects, crs, trajectory, sections, lines)


def as_of_files(inventory: RoadInventory) -> RoadInventory:
    """Return the inventory as a GeoPackage gives it back: without negative zeros, which other files would show."""

    def positive(table: pd.DataFrame | None) -> Any:
        return None if table is None else table.assign(**(table.select_dtypes("float64") + 0.0))

    tables = {name: positive(getattr(inventory, name)) for name in ("objects", "sections", "lines")}
    return replace(inventory, **tables)


def _keys_of_survey(folder: Path, crs: str | None) -> pd.DataFrame:
    """Return kind, place and key of the objects of an earlier survey, without its parked vehicles."""
    table = read_objects(folder).table
    if "key" not in table:
        raise ReadError(f"label.keys_from: {folder} has no inventory with keys")
    own = system_of(folder)
    if own is not None and crs is not None and not own.equals(CRS.from_user_input(crs), ignore_axis_order=True):
        raise DataError(f"label.keys_from: {folder} is in {own.name}, this survey in {CRS.from_user_input(crs).name}")
    return _with_keys(table[table["kind"] != "vehicle"])


def _with_keys(table: pd.DataFrame) -> pd.DataFrame:
    """Return the columns that keys are matched by; an inventory of an earlier version has no keys.

    Objects that a user changed have the kind that the user gave.
    """
    if "key" not in table:
        table = table.iloc[:0].assign(key="")
    given = table["checked_class"].fillna("") if "checked_class" in table else pd.Series("", index=table.index)
    kind = given.map(KIND_OF_CLASS | {name: name for name in KINDS}).fillna(table["kind"])
    return table.assign(kind=kind, key=table["key"].fillna(""))[["kind", "x", "y", "key"]]


def read_sections(path: Path) -> pd.DataFrame:
    """Read a table of road sections: `section`, `from_station`, `to_station`; errors name the file."""
    if not path.is_file():
        raise ReadError(f"label.sections: {path} does not exist")
    try:
        with path.open(encoding="utf-8-sig", errors="replace") as stream:
            separator = next((mark for mark in (";", "\t") if mark in stream.readline()), ",")
        table = pd.read_csv(path, sep=separator, encoding="utf-8-sig", skipinitialspace=True)
        for name in ("from_station", "to_station"):
            if name in table:
                if separator != "," and not pd.api.types.is_numeric_dtype(table[name]):  # decimal commas
                    table[name] = table[name].str.strip().str.replace(",", ".", regex=False)
                table[name] = pd.to_numeric(table[name]).astype(np.float64)
        section_table(pd.DataFrame({"kind": [], "station": []}), 0.0, sections=table)
    except (OSError, DataError, *WRONG) as error:  # the errors of pandas are values
        raise ReadError(f"{path}: not a table of road sections: {' '.join(str(error).split())}") from error
    return table


def export_inventory(inventory: RoadInventory, formats: Sequence[str], run: RunFolder) -> list[str]:
    """Write an inventory in several formats, move the files to their places and return their paths."""
    folder = run.staged(run.output / "inventory").parent
    folder.mkdir(parents=True, exist_ok=True)
    written: list[str] = []
    for name in formats:
        written += [str(run.publish(path)) for path in EXPORTS[name].write(inventory, folder)]
    return list(dict.fromkeys(written))

"""The inventory of a survey that `label` labels: the work that joins its objects, and what comes of it."""

from __future__ import annotations

from collections.abc import Mapping

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.inventory.rules import ObjectRule
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.scenes.cutting import corridor_from_arrays
from mlsroad_pipeline.algorithms.scenes.trajectory import Trajectory
from mlsroad_pipeline.datasets.inventory.road_inventory import RoadInventory
from mlsroad_pipeline.datasets.scene_store_dataset import SceneCollection
from mlsroad_pipeline.execution.task import Deferred, SceneTask
from mlsroad_pipeline.label.work import join_objects
from mlsroad_pipeline.surveys.plan import SurveyPlan

OBJECTS = "inventory"
"""What the table of the objects is called beside the written files, whose names begin with the split."""


def scenes_of(drive: str, results: SceneCollection) -> list[str]:
    """Return the keys of a drive's scenes.

    Parameters
    ----------
    drive : str
        Name of the drive in the stores.
    results : SceneCollection
        The scenes of all drives.

    Returns
    -------
    list of str
        In the order of the collection.
    """
    return [key for key in results if key.rpartition(".")[0] == drive]


def objects_task(
    plan: SurveyPlan,
    corridors: SceneCollection,
    results: SceneCollection,
    rules: Mapping[str, ObjectRule],
    bundle: ModelBundle,
) -> SceneTask:
    """Plan the work that joins the objects of all scenes of a survey.

    Parameters
    ----------
    plan : SurveyPlan
        The files.
    corridors : SceneCollection
        Their trajectories.
    results : SceneCollection
        What the scenes found.
    rules : mapping of str to ObjectRule
        The rules that the objects were found with.
    bundle : ModelBundle
        The model, whose method and version stand beside each object.

    Returns
    -------
    SceneTask
        It gives the table of the objects.
    """
    drives = {drive: scenes_of(drive, results) for drive in plan.drives()}
    parts = {
        name: {drive: Deferred(tuple(found[key] for key in keys)) for drive, keys in drives.items()}
        for name in ("objects", "fragments")
        for found in [results.part(name)]
    }
    registered = bundle.metadata.get("registered")
    version = "" if registered is None else f"{registered['name']} {registered['version']}"
    return SceneTask(
        join_objects,
        {"corridors": {drive: corridors[drive] for drive in drives}, **parts},
        {"rules": dict(rules), "method": bundle.slug, "model_version": version},
    )


def survey_crs(plan: SurveyPlan, files: SceneCollection) -> str | None:
    """Return the coordinate reference system of a survey.

    Parameters
    ----------
    plan : SurveyPlan
        The files.
    files : SceneCollection
        Their samples.

    Returns
    -------
    str or None
        As WKT; None where the files have none.

    Raises
    ------
    DataError
        If the files have different ones: one map cannot hold them.
    """
    samples = files.part("sample")
    systems = {file.source.name: samples[file.key].load().crs for file in plan.files}
    one, crs = next(iter(systems.items()))
    other = next((name for name, system in systems.items() if system != crs), None)
    if other is not None:
        raise DataError(f"{one} and {other} have different coordinate reference systems: label them one by one")
    return crs


def inventory_of(
    plan: SurveyPlan, files: SceneCollection, corridors: SceneCollection, written: SceneCollection
) -> RoadInventory:
    """Return the inventory of a survey.

    Parameters
    ----------
    plan : SurveyPlan
        The files.
    files : SceneCollection
        Their samples, for the coordinate reference system.
    corridors : SceneCollection
        Their trajectories.
    written : SceneCollection
        What was written, the table of the objects among it.

    Returns
    -------
    RoadInventory
        The objects, the coordinate reference system, and the trajectory of a survey with one drive.

    Raises
    ------
    DataError
        If the files have different coordinate reference systems.
    """
    drives = list(plan.drives())
    corridor = corridor_from_arrays(corridors[drives[0]].load()) if len(drives) == 1 else None
    trajectory = corridor if isinstance(corridor, Trajectory) else None
    return RoadInventory(written[OBJECTS].load(), survey_crs(plan, files), trajectory)

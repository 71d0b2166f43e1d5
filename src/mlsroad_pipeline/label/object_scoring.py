"""Scores of the inventory of a labelled survey against a table of true objects."""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import shapely

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError, ReadError
from mlsroad_pipeline.algorithms.inventory.objects.rules import KINDS
from mlsroad_pipeline.algorithms.inventory.scoring.object_scores import (
    MatchedObjects,
    errors_of_measures,
    match_objects,
    precision_recall_curve,
    score_objects,
    summarise_measures,
)
from mlsroad_pipeline.inventory_files.exports import read_inventory
from mlsroad_pipeline.surveys.truth_tables import (
    Truth,
    counted_objects,
    instances_of_objects,
    point_counts,
    read_truth,
)

logger = logging.getLogger(__name__)

NEAR = 100.0
"""Largest distance in metres between the extents of an inventory and of its truth without a warning."""

INVENTORIES = ("inventory.parquet", "inventory.gpkg")
"""Inventory files of a folder of results, the first that exists is read."""


@dataclass(frozen=True)
class ScoreParameters:
    """An inventory and the truth that it is scored against."""

    inventory: str = ""  # GeoPackage or GeoParquet file of an inventory, or a folder of results
    truth: str = ""  # Table of true objects or folder of a simulated street: `surveys.truth_tables.read_truth`
    output: str = ""  # Folder of the scores; empty takes the folder of the reports of the project
    # Labelled point clouds; none takes the LAZ files in the folder of the inventory. They count the points of true
    # objects and give pictures.
    clouds: Sequence[str] = ()
    least_score: float = 0.0  # Objects with a lower score are not scored
    recall_only: Sequence[str] = ()  # Kinds whose truth is incomplete: only their recall is computed
    # Kind to the fewest points of a true object that counts; default: of an object of the inventory
    least_points: Mapping[str, int] = field(default_factory=dict)
    # Kind to the largest distance in plan of an object from its true object, metres; default: 0.5 for poles and signs,
    # 1 for trees and vehicles
    reach: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in ("recall_only", "least_points", "reach"):
            for kind in getattr(self, name):
                if kind not in KINDS:
                    raise ParameterError(f"score.{name}: unknown kind {kind!r} (known: {', '.join(KINDS)})")
        if not 0 <= self.least_score <= 1:
            raise ParameterError(f"score.least_score must be in 0 to 1, got {self.least_score}")


def inventory_file(place: str) -> Path:
    """Return the file of an inventory: the path itself, or the inventory in a folder of results."""
    path = Path(place)
    found = next((path / name for name in INVENTORIES if (path / name).is_file()), None) if path.is_dir() else path
    if found is None or not found.is_file():
        raise ReadError(f"{place} holds no {' or '.join(INVENTORIES)}: label the survey first (mlsroad label FILE)")
    if found.suffix.lower() not in (".gpkg", ".parquet"):
        raise ReadError(f"{place}: an inventory is a .gpkg or .parquet file, or a folder of results")
    return found


def cloud_files(parameters: ScoreParameters) -> list[Path]:
    """Return the labelled clouds of an inventory; cloud-optimised copies repeat the points of others."""
    if parameters.clouds:
        return [Path(name) for name in parameters.clouds]
    folder = inventory_file(parameters.inventory).parent
    return [path for path in sorted(folder.rglob("*.laz")) if not path.name.endswith(".copc.laz")]


class ScoredInventory(NamedTuple):
    """Outcomes of all objects with their scores, as tables."""

    matched: MatchedObjects
    scores: pd.DataFrame
    curve: pd.DataFrame
    errors: pd.DataFrame
    measures: pd.DataFrame
    clouds: list[Path]
    source: str


def score_inventory(parameters: ScoreParameters) -> ScoredInventory:
    """Match an inventory with its truth and compute all scores; kinds without any truth are not scored."""
    for name in ("inventory", "truth"):
        if not getattr(parameters, name):
            raise ParameterError(f"score.{name} is empty: name a file or folder")
    truth = read_truth(parameters.truth)
    clouds = cloud_files(parameters)
    true = counted_objects(truth, point_counts(truth, clouds), parameters.least_points)
    objects = read_inventory(inventory_file(parameters.inventory)).objects
    kinds = {"vehicle"} if truth.source not in ("table", "simulated") else set(true["kind"])
    kinds = set(KINDS) if truth.source == "simulated" else kinds
    listed = objects[objects["kind"].isin(kinds) & (objects["score"] >= parameters.least_score)]
    listed = _placed(listed.reset_index(drop=True), truth)
    listed["inside"] &= (listed["motion"] != "moving") & ~_of_uncounted(
        listed, true, instances_of_objects(truth, clouds)
    )
    warn_of_distance(objects, truth.objects, "true objects")
    matched = match_objects(listed, true, reach=parameters.reach)
    complete = listed[~listed["kind"].isin(list(parameters.recall_only))]
    errors = errors_of_measures(matched)
    return ScoredInventory(
        matched,
        score_objects(matched, recall_only=parameters.recall_only),
        precision_recall_curve(complete, true, reach=parameters.reach),
        errors,
        summarise_measures(errors),
        clouds,
        truth.source,
    )


def warn_of_distance(objects: pd.DataFrame, others: pd.DataFrame, name: str) -> None:
    """Log a warning where the extents of an inventory and of other objects lie far apart in plan."""
    if objects.empty or others.empty:
        return
    one, other = (shapely.box(t["x"].min(), t["y"].min(), t["x"].max(), t["y"].max()) for t in (objects, others))
    metres = shapely.distance(one, other)
    if metres > NEAR:
        logger.warning(
            "The %s are %s m from those of the inventory: the table has another coordinate system, or x and "
            "y exchanged",
            name,
            f"{metres:,.0f}",
        )


def _placed(objects: pd.DataFrame, truth: Truth) -> pd.DataFrame:
    """Return objects with `inside`: whether the truth is complete at their place."""
    if truth.region is None:
        return objects.assign(inside=np.ones(len(objects), bool))
    return objects.assign(inside=shapely.contains_xy(truth.region, objects["x"], objects["y"]))


def _of_uncounted(objects: pd.DataFrame, true: pd.DataFrame, instance: pd.Series) -> pd.Series:
    """Return which objects have most of their points from a true object of their kind that does not count."""
    if instance.empty:
        return pd.Series(False, index=objects.index)
    spare = true[~true["counted"].astype(bool)].drop_duplicates("instance").set_index("instance")["kind"]
    kind = objects["object_id"].map(instance).map(spare)
    return kind.notna() & (kind == objects["kind"])


def score_record(scored: ScoredInventory, parameters: ScoreParameters) -> dict[str, Any]:
    """Return the scores as JSON values."""

    def records(table: pd.DataFrame) -> list[dict[str, Any]]:
        rows = table.astype(object).where(table.notna(), None)
        return [{str(name): value for name, value in row.items()} for row in rows.to_dict("records")]

    return {
        "inventory": parameters.inventory,
        "truth": parameters.truth,
        "kind_of_truth": scored.source,
        "least_score": parameters.least_score,
        "scores": records(scored.scores),
        "measures": records(scored.measures),
    }

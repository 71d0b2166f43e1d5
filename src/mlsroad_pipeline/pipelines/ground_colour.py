"""Pipeline that trains the regression by which the shipped pool divides paved from natural ground by colour."""

import logging
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from kedro.pipeline import Pipeline
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.models.pool.ground_colour_training import Ground, fit, grounds_of, held_out_f1
from mlsroad_pipeline.algorithms.models.pool.labeller import SLUG, with_ground_colour
from mlsroad_pipeline.execution.collection import SceneCollection
from mlsroad_pipeline.execution.task import SceneTask
from mlsroad_pipeline.model_store.bundle_files import ModelFile
from mlsroad_pipeline.model_store.shipped_entry import ShippedParameters
from mlsroad_pipeline.model_store.shipped_models import FOLDER, ShippedModel, shipped_again
from mlsroad_pipeline.pipelines.per_scene import named_node
from mlsroad_pipeline.simulation.parameters.presets import SimulationParameters, simulation_parameters
from mlsroad_pipeline.simulation.runtime.survey import simulate_survey

log = logging.getLogger(__name__)

KINDS = ("residential", "old_town", "american_suburb", "downtown", "town", "suburb", "industrial", "rural",
         "asian_arterial", "campus", "ring_road")  # fmt: skip
SCANNED = ("town", "suburb", "rural", "american_suburb")
LINES, SCANS = ("small", "small", "demo", "tiny"), ("hdl64", "pandaset")


def colour_streets(number: int) -> list[dict[str, Any]]:
    """Return the surveys to simulate: a sixth are single scans, the others line scanners on a vehicle."""
    n_scans = number // 6
    scan = {"length": 96, "speed": 20, "scan_spacing": 16}
    scans = [{"preset": SCANS[k % 2], "seed": 9300 + k, "street": SCANNED[k // 2 % 4], **scan} for k in range(n_scans)]
    lines = [
        {"preset": LINES[k % 4], "seed": 9200 + k, "street": KINDS[k % 11], "length": 60}
        for k in range(number - n_scans)
    ]
    return [*scans, *lines]


def describe_street(*, simulation: SimulationParameters, model: ModelBundle) -> dict[str, Mapping[str, NDArray]]:
    """Simulate and label a street, and return its ground with its own colours and with others."""
    grounds = grounds_of(simulate_survey(simulation).cloud, model, simulation.seed)
    return {f"colours_{number}": one._asdict() for number, one in enumerate(grounds)}


def describe_colour_streets(shipped: ShippedParameters) -> dict[str, SceneTask]:
    """Create one task per street."""
    model = ModelFile(str(FOLDER / SLUG))
    configs = [{**config, **shipped.colour_survey} for config in colour_streets(shipped.colour_streets)]
    return {
        f"street_{number:03d}": SceneTask(describe_street, {"model": model}, {"simulation": simulation_parameters(one)})
        for number, one in enumerate(configs)
    }


def train_ground_colour(streets: SceneCollection) -> tuple[ModelBundle, ShippedModel]:
    """Train the regression; return the pool with its weights, and its registry entry, which then names colour."""
    surveys = [[Ground(**parts[name]) for name in sorted(parts)] for parts in streets.load_all().values()]
    f1 = held_out_f1(surveys)
    if len(f1):
        log.info(
            "F1 of natural ground on %d held-out streets, mean (minimum): without colour %.3f (%.3f), own colours %.3f "
            "(%.3f), other colours %.3f (%.3f)",
            len(f1),
            *np.stack([f1.mean(axis=0), f1.min(axis=0)], axis=1).ravel(),
        )
    bundle, entry = shipped_again(SLUG)
    weights = fit([one for street in surveys for one in street])
    attributes = tuple(dict.fromkeys((*entry.attributes, "rgb")))
    return with_ground_colour(bundle, weights), replace(entry, attributes=attributes)


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline: parameters to the pool of the package with its weights of colour."""
    return Pipeline(
        [
            named_node(describe_colour_streets, "ground_colour.streets"),
            named_node(train_ground_colour, "shipped_pool", streets="ground_colour.streets"),
        ]
    )

"""Sets of objects from simulated surveys."""

from collections.abc import Mapping
from itertools import chain
from typing import Any

import pandas as pd
from kedro.pipeline import Pipeline

from mlsroad_pipeline.algorithms.core.classes import find_scheme
from mlsroad_pipeline.algorithms.core.stage_parameters import GroundParameters
from mlsroad_pipeline.algorithms.segmentation.stage import SegmentationParameters
from mlsroad_pipeline.execution.collection import SceneCollection
from mlsroad_pipeline.execution.task import SceneTask
from mlsroad_pipeline.papers.luo2019.study import sets as object_sets
from mlsroad_pipeline.papers.shared.studies.streets import street_tasks
from mlsroad_pipeline.pipelines.per_scene import named_node


def cut_streets(
    parameters: object_sets.SimulatedObjectsParameters,
    ground: GroundParameters,
    segmentation: SegmentationParameters,
    classes: Mapping[str, Any],
) -> dict[str, SceneTask]:
    """Create one task per street: simulation and extraction of the objects."""
    tasks: dict[str, SceneTask] = {}
    for name, config in parameters.chosen_sets().items():
        seeds = chain.from_iterable(config.seeds_of_splits().values())
        tasks |= street_tasks(
            object_sets.cut_street,
            {f"{name}.seed_{seed}": {**config.survey, "seed": seed} for seed in seeds},
            ground=ground,
            segmentation=segmentation,
            scheme=find_scheme(classes["schemes"], name),
            wanted=list(object_sets.OBJECTS[name]),
            parameters=parameters.cut,
        )
    return tasks


def draw_splits(
    parameters: object_sets.SimulatedObjectsParameters, streets: SceneCollection, classes: Mapping[str, Any]
) -> dict[str, SceneTask]:
    """Create one task per split of each set: sampling of the objects."""
    return {
        str(object_sets.SplitKey(name, split)): SceneTask(
            object_sets.draw_split,
            {"streets": {f"seed_{seed}": streets[f"{name}.seed_{seed}"] for seed in seeds}},
            {
                "limits": object_sets.wanted_objects(name, config, find_scheme(classes["schemes"], name))[split],
                "seed": parameters.seed,
            },
        )
        for name, config in parameters.chosen_sets().items()
        for split, seeds in config.seeds_of_splits().items()
    }


def tabulate_sets(
    parameters: object_sets.SimulatedObjectsParameters, sets: SceneCollection, classes: Mapping[str, Any]
) -> pd.DataFrame:
    """Return the composition of the sets."""
    schemes = {name: find_scheme(classes["schemes"], name) for name in parameters.chosen_sets()}
    wanted = {
        object_sets.SplitKey(name, split): limits
        for name, config in parameters.chosen_sets().items()
        for split, limits in object_sets.wanted_objects(name, config, schemes[name]).items()
    }
    return object_sets.composition_table({key: sets[str(key)].load() for key in wanted}, wanted, schemes)


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline: parameters to ``simulated_objects.streets``, ``.sets`` and ``.composition``."""
    slug = "simulated_objects"
    return Pipeline(
        [
            named_node(cut_streets, ".streets", "cut_simulated_streets", slug=slug),
            named_node(draw_splits, ".sets", "draw_simulated_sets", slug=slug, streets=".streets"),
            named_node(tabulate_sets, ".composition", "tabulate_simulated_sets", slug=slug, sets=".sets"),
        ]
    )

"""Stages whose results Kedro's own data sets keep, in place of scene stores."""

import numpy as np
import pandas as pd
import pytest
from kedro.io import DataCatalog, MemoryDataset
from kedro.runner import SequentialRunner
from kedro_datasets.partitions import PartitionedDataset
from kedro_datasets.pickle import PickleDataset

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.stage_parameters import GroundParameters, SupervoxelParameters
from mlsroad_pipeline.datasets.scene_store_dataset import SceneStoreDataset
from mlsroad_pipeline.execution.task import SceneTask
from mlsroad_pipeline.pipelines.stages import create_pipeline

STAGES = ("ground", "ground_counts", "supervoxels", "supervoxel_quality_of_scenes")
TABLES = ("ground_scores", "supervoxel_quality")


def street(seed: int) -> PointCloud:
    """A flat road with a wall beside it, labelled."""
    rng = np.random.default_rng(seed)
    road = np.column_stack([rng.uniform(0, 12, (4000, 2)), rng.normal(0, 0.01, 4000)])
    wall = np.column_stack([rng.uniform(0, 12, 2500), rng.normal(12, 0.01, 2500), rng.uniform(0, 4, 2500)])
    xyz = np.concatenate([road, wall]).astype(np.float32)
    label = np.repeat([TAXONOMY["road"], TAXONOMY["building"]], [4000, 2500]).astype(np.uint8)
    return PointCloud(xyz, {"label": label, "core": np.ones(len(xyz), np.bool_)}, source=f"street {seed}")


def store(name):
    return SceneStoreDataset(filepath=f"memory://stock/{name}", execution={"backend": "sequential"})


def tables(stages):
    scenes = store("scenes")
    scenes.save({f"test{k}": SceneTask(street, parameters={"seed": k}) for k in range(2)})
    parameters = {"ground_removal": GroundParameters(), "supervoxelise": SupervoxelParameters()}
    given = {f"params:{name}": MemoryDataset(value) for name, value in parameters.items()}
    catalog = DataCatalog({"scenes": scenes, **given, **stages, **{name: MemoryDataset() for name in TABLES}})
    pipeline = create_pipeline("ground_removal") + create_pipeline("supervoxelise")
    SequentialRunner().run(pipeline, catalog)
    return {name: catalog.load(name) for name in TABLES}


@pytest.fixture(scope="module")
def stored():
    return tables({name: store(name) for name in STAGES})


@pytest.mark.parametrize("swapped", [STAGES[:1], STAGES[1:], STAGES])
def test_partitioned_data_sets_give_the_tables_of_scene_stores(stored, swapped, tmp_path):
    def partitioned(name):
        part = {"type": PickleDataset}
        return PartitionedDataset(path=str(tmp_path / name), dataset=part, filename_suffix=".pickle")

    found = tables({name: partitioned(name) if name in swapped else store(f"own/{name}") for name in STAGES})
    for name in TABLES:
        pd.testing.assert_frame_equal(found[name], stored[name])
    assert len(list(tmp_path.rglob("*.pickle"))) == 2 * len(swapped)


def test_tasks_in_memory_are_computed_where_they_are_used(stored):
    found = tables({name: MemoryDataset(copy_mode="assign") for name in STAGES})
    for name in TABLES:
        pd.testing.assert_frame_equal(found[name], stored[name])

"""Kedro dataset of a point cloud, created by a catalog."""

import numpy as np
import pytest
from helpers.formats import make_las
from kedro.io import DataCatalog, DatasetError

from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud

TYPE = "mlsroad_pipeline.datasets.point_cloud_dataset.PointCloudDataset"


def make_catalog(path, **entry):
    return DataCatalog.from_config({"cloud": {"type": TYPE, "filepath": str(path), **entry}})


def test_catalog_entry_maps_columns_units_and_codes(tmp_path):
    (tmp_path / "a.csv").write_text("1000,2000,3000,5\n")
    load = {"columns": {"label": 3}, "units": "millimetre", "coding": {5: "car"}}
    cloud = make_catalog(tmp_path / "a.csv", load_args=load).load("cloud")
    assert (cloud.world_xyz().tolist(), cloud["label"].tolist()) == ([[1, 2, 3]], [50])


def test_what_was_loaded_is_saved_unchanged(tmp_path, rng):
    make_las(tmp_path / "a.las", rng, geotiff=25832)
    source, target = make_catalog(tmp_path / "a.las"), make_catalog(tmp_path / "b.las")
    assert not target.exists("cloud")
    target.save("cloud", source.load("cloud"))
    assert (tmp_path / "b.las").read_bytes() == (tmp_path / "a.las").read_bytes()
    assert target.exists("cloud")


@pytest.mark.parametrize("name", ["a.laz", "a.ply", "a.xyz", "a.bin"])
def test_every_format_saves_and_loads(tmp_path, name):
    cloud = PointCloud(np.array([[0.5, 1.25, 2.0], [3.0, 4.0, 5.5]]), {"intensity": np.array([0, 1], np.float32)})
    catalog = make_catalog(tmp_path / name)
    catalog.save("cloud", cloud)
    back = catalog.load("cloud")
    np.testing.assert_array_equal(back.world_xyz(), cloud.xyz)
    np.testing.assert_array_equal(back["intensity"], [0, 1])


def test_errors_name_file_and_value(tmp_path):
    with pytest.raises(DatasetError, match=r"unknown ReadOptions colour"):
        make_catalog(tmp_path / "a.las", load_args={"colour": 1}).load("cloud")
    with pytest.raises(DatasetError, match=r"a\.las does not exist"):
        make_catalog(tmp_path / "a.las").load("cloud")
    with pytest.raises(DatasetError, match=r"a\.dwg: no format with this extension \(known: .*\.laz"):
        make_catalog(tmp_path / "a.dwg").save("cloud", PointCloud(np.zeros((1, 3))))

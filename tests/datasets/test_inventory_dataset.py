"""The dataset of the inventory selects the format by the file's extension."""

import pytest
from kedro.io import DataCatalog, DatasetError

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.inventory.objects.table import OBJECT_FIELDS, empty_table
from mlsroad_pipeline.datasets.inventory_dataset import RoadInventoryDataset
from mlsroad_pipeline.inventory_files.road_inventory import RoadInventory


@pytest.mark.parametrize(("name", "written"), [("i.gpkg", ["i.gpkg", "i.qml"]), ("i.parquet", ["i.parquet"])])
def test_a_catalog_entry_writes_the_format_of_its_extension(tmp_path, name, written):
    kind = f"{RoadInventoryDataset.__module__}.{RoadInventoryDataset.__name__}"
    catalog = DataCatalog.from_config({"inventory": {"type": kind, "filepath": str(tmp_path / name)}})
    catalog.save("inventory", RoadInventory(empty_table(OBJECT_FIELDS), "EPSG:25832"))
    assert sorted(path.name for path in tmp_path.iterdir()) == written
    assert len(catalog.load("inventory").objects) == 0


@pytest.mark.parametrize("name", ["inventory.shp", "inventory"])
def test_another_extension_is_refused(name):
    with pytest.raises(DatasetError, match=rf"{name}: an inventory needs the extension \.gpkg or \.parquet, got"):
        RoadInventoryDataset(filepath=name)


def test_an_unchanged_file_is_read_once_and_a_changed_or_removed_one_again(tmp_path):
    path = tmp_path / "i.parquet"
    dataset = RoadInventoryDataset(filepath=str(path))
    dataset.save(RoadInventory(empty_table(OBJECT_FIELDS), "EPSG:25832"))
    first = dataset.load()
    assert dataset.load() is first
    dataset.save(RoadInventory(empty_table(OBJECT_FIELDS), "EPSG:25833"))
    assert "25833" in dataset.load().crs
    path.unlink()
    with pytest.raises(DatasetError, match="i.parquet"):
        dataset.load()


def test_a_file_written_in_the_background_is_there_for_whoever_asks(tmp_path):
    path = tmp_path / "i.gpkg"
    dataset = RoadInventoryDataset(filepath=str(path), background=True)
    dataset.save(RoadInventory(empty_table(OBJECT_FIELDS), "EPSG:25832"))
    assert dataset.filepath.is_file()
    dataset.save(RoadInventory(empty_table(OBJECT_FIELDS), "EPSG:25833"))
    assert "25833" in dataset.load().crs


def test_an_error_in_the_background_is_raised_once_by_whoever_asks(tmp_path):
    dataset = RoadInventoryDataset(filepath=str(tmp_path / "i.gpkg"), background=True)
    dataset.save(RoadInventory(empty_table(OBJECT_FIELDS), "no system"))
    with pytest.raises(DataError, match=r"i\.gpkg: the coordinate reference system 'no system' is not understood"):
        dataset.finish()
    assert not dataset.exists()

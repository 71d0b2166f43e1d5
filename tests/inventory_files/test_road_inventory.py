"""Files of GDAL, of which a failed write that it does not report leaves none behind."""

import pyogrio
import pytest
from helpers.inventories import planted_inventory

from mlsroad_pipeline.inventory_files.exports import EXPORTS
from mlsroad_pipeline.inventory_files.geopackage import write_geopackage
from mlsroad_pipeline.inventory_files.road_inventory import write_whole

WRITERS = {
    "geopackage": lambda inventory, folder: write_geopackage(inventory, folder / "inventory.gpkg"),
    **{name: EXPORTS[name].write for name in ("geojson", "flatgeobuf", "shapefile")},
}


@pytest.mark.parametrize("name", WRITERS)
def test_a_write_that_gdal_loses_is_an_error_and_leaves_no_file(name, tmp_path, monkeypatch):
    write, count = pyogrio.write_dataframe, 0

    def losing(frame, path, **options):
        nonlocal count
        count += 1
        write(frame.iloc[:-1] if count == 1 and name != "geopackage" else frame, path, **options)
        if name == "geopackage" and count == 1:
            content = bytearray(path.read_bytes())
            content[content.index(b"slender")] ^= 1
            path.write_bytes(content)

    monkeypatch.setattr(pyogrio, "write_dataframe", losing)
    with pytest.raises(OSError, match="GDAL did not write all of"):
        WRITERS[name](planted_inventory(), tmp_path)
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == []


def test_a_missing_part_is_an_error_and_whole_files_replace_others(tmp_path):
    (tmp_path / "a").write_text("old")
    numbers = iter(range(2))
    with pytest.raises(OSError, match="GDAL did not write all of a below"):
        write_whole(tmp_path, lambda folder: (folder / "ab"[next(numbers)]).write_text("new"))
    assert (tmp_path / "a").read_text() == "old"
    assert write_whole(tmp_path, lambda folder: (folder / "a").write_text("new")) == [tmp_path / "a"]
    assert (tmp_path / "a").read_text() == "new" and len(list(tmp_path.iterdir())) == 1

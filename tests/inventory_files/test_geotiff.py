"""GeoTIFF against the tags of its standard, read by another library."""

import numpy as np
import pytest
from PIL import Image

from mlsroad_pipeline.inventory_files.geotiff import write_geotiff


@pytest.mark.parametrize(("crs", "code"), [("EPSG:25833", 25833), (None, 32767)])
def test_values_place_and_system(tmp_path, crs, code):
    values = np.arange(12, dtype=np.float32).reshape(3, 4)
    values[1, 2] = np.nan
    write_geotiff(values, tmp_path / "r.tif", corner=(389_300.5, 5_819_700.0), edge=0.5, crs=crs)
    with Image.open(tmp_path / "r.tif") as image:
        assert np.array_equal(np.asarray(image), values, equal_nan=True) and image.mode == "F"
        tags = image.tag_v2
        assert tags[33550] == (0.5, 0.5, 0.0) and tags[33922] == (0, 0, 0, 389_300.5, 5_819_700.0, 0)
        keys = dict(zip(tags[34735][4::4], tags[34735][7::4], strict=True))
        assert keys == {1024: 1, 1025: 1, 3072: code} and tags[42113].strip("\0") == "nan"
    again = tmp_path / "again.tif"
    write_geotiff(values, again, corner=(389_300.5, 5_819_700.0), edge=0.5, crs=crs)
    assert again.read_bytes() == (tmp_path / "r.tif").read_bytes()

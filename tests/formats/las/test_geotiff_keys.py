"""GeoTIFF keys of LAS files against the same systems made by pyproj."""

import laspy
import numpy as np
import pyproj
import pytest
from helpers.formats import make_labels, make_las
from laspy.vlrs.vlr import VLR

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.formats.base import ReadOptions, WriteOptions
from mlsroad_pipeline.formats.las.format import LasFormat
from mlsroad_pipeline.formats.las.geotiff_keys import GeotiffKeys, pack_directory
from mlsroad_pipeline.label.writer import write_labelled

LAS = LasFormat()
DEFAULT = ReadOptions()
GRS80 = {2048: 32767, 2050: 32767, 2057: 6378137.0, 2059: 298.257222101}
SPELLED = {
    "code": ({3072: 25832}, "EPSG:25832"),
    "code in US feet": ({1024: 1, 3072: 2272, 3076: 9003}, "EPSG:2272"),
    "geographic code": ({1024: 2, 2048: 4258}, "EPSG:4258"),
    "with heights": ({3072: 28992, 4096: 5709}, "EPSG:7415"),
    "heights by their datum, GeoTIFF 1.0": ({3072: 26917, 4096: 5103}, "EPSG:26917+5703"),
    "heights in US feet": ({3072: 2272, 4096: 5703, 4099: 9003}, "EPSG:2272+6360"),
    "conversion by code": ({3072: 32767, 3074: 16032, 2048: 4258, 3076: 9001}, "EPSG:25832"),
    "datum by code": ({3072: 32767, 3074: 16032, 2048: 32767, 2050: 6258}, "EPSG:25832"),
    "transverse Mercator": (
        {3072: 32767, 3075: 1, 3080: 9.0, 3081: 0.0, 3092: 0.9996, 3082: 5e5, 3083: 0.0, **GRS80},
        "+proj=tmerc +lat_0=0 +lon_0=9 +k=0.9996 +x_0=500000 +y_0=0 +ellps=GRS80",
    ),
    "Lambert with two parallels, feet": (
        {
            **{3072: 32767, 3075: 8, 3076: 9003, 2048: 4269, 3078: 40.966666666666667, 3079: 39.933333333333333},
            **{3084: -77.75, 3085: 39.333333333333333, 3086: 1968500.0, 3087: 0.0},
        },
        "EPSG:2272",
    ),
    "Lambert with one parallel": (
        {3072: 32767, 3075: 9, 3080: 3.0, 3081: 46.5, 3092: 0.9999, 3082: 7e5, 3083: 6.6e6, **GRS80},
        "+proj=lcc +lat_1=46.5 +lat_0=46.5 +lon_0=3 +k_0=0.9999 +x_0=700000 +y_0=6600000 +ellps=GRS80",
    ),
    "Albers": (
        {3072: 32767, 3075: 11, 3078: 29.5, 3079: 45.5, 3084: -96.0, 3085: 23.0, 2048: 4269},
        "EPSG:5070",
    ),
    "Lambert equal area": (
        {3072: 32767, 3075: 10, 3088: 10.0, 3089: 52.0, 3082: 4_321_000.0, 3083: 3_210_000.0, 2048: 4258},
        "EPSG:3035",
    ),
    "Mercator on an ellipsoid by axes": (
        {3072: 32767, 3075: 7, 3080: 5.0, 2048: 32767, 2057: 6378388.0, 2058: 6356911.946127946},
        "+proj=merc +lon_0=5 +ellps=intl",
    ),
}


def records(keys):
    """Pack keys as a writer would: floats and texts behind the directory."""
    words, doubles, texts = [], [], ""
    for key, value in sorted(keys.items()):
        if isinstance(value, float):
            words.append([key, 34736, 1, len(doubles)])
            doubles.append(value)
        elif isinstance(value, str):
            words.append([key, 34737, len(value) + 1, len(texts)])
            texts += value + "|"
        else:
            words.append([key, 0, 1, value])
    directory = np.array([[1, 1, 0, len(words)], *words], "<u2").tobytes()
    return directory, np.array(doubles, "<f8").tobytes(), texts.encode()


def make(path, rng, keys, *, version="1.2"):
    las = make_las(path, rng, version=version, point_format=3, extras=False)
    for number, data in zip((34735, 34736, 34737), records(keys), strict=True):
        las.header.vlrs.append(VLR("LASF_Projection", number, "keys", data))
    las.write(str(path))


@pytest.mark.parametrize(("keys", "same"), SPELLED.values(), ids=SPELLED.keys())
def test_systems_that_keys_name_or_spell_out(tmp_path, rng, keys, same):
    make(tmp_path / "a.las", rng, {**keys, 3073: "of the town"})
    found, expected = pyproj.CRS(LAS.info(tmp_path / "a.las", DEFAULT).crs), pyproj.CRS(same)
    assert [a.unit_name for a in found.axis_info] == [a.unit_name for a in expected.axis_info]
    base = expected.sub_crs_list[0] if expected.is_compound else expected
    if base.is_geographic:
        assert found.to_epsg() == base.to_epsg()
        return
    center = base.area_of_use
    longitude, latitude = (9.3, 47.1) if center is None else ((center.west + center.east) / 2, center.south + 0.4)
    flat = [pyproj.Transformer.from_crs(c.geodetic_crs, c, always_xy=True) for c in (found, base)]
    ours, theirs = (t.transform(longitude, latitude) for t in flat)
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-5)
    if expected.is_compound:
        assert found.sub_crs_list[1].to_epsg() == expected.sub_crs_list[1].to_epsg()


@pytest.mark.parametrize(
    ("keys", "what"),
    [
        ({3072: 32767}, "a projection without a transformation"),
        ({3072: 32767, 3075: 3, 2048: 4258}, "transformation 3"),
        ({3072: 32767, 3075: 8, 2048: 4258}, "transformation 8 without key 3078"),
        ({3072: 32767, 3075: 1, 2048: 32767}, "a user-defined datum without an ellipsoid"),
        ({3072: 32767, 3075: 1, 3076: 9098, 2048: 4258}, "linear unit 9098"),
        ({2048: 32767, 2054: 9105, 2057: 6378137.0, 2059: 298.0}, "angular unit 9105"),
        ({1025: 1}, "they name no system"),
        ({1024: 1, 2048: 4258}, "a projected system without its code"),
        ({3072: 25832, 4096: 25833}, "vertical system 25833"),
        ({3072: 1500}, "EPSG:1500"),
    ],
)
def test_what_is_not_understood_is_no_system_and_is_told(tmp_path, rng, caplog, keys, what):
    make(tmp_path / "a.las", rng, keys)
    with caplog.at_level("INFO"):
        assert LAS.info(tmp_path / "a.las", DEFAULT).crs is None  # never guessed
    assert "a.las: its GeoTIFF keys give no coordinate reference system" in caplog.text and what in caplog.text
    assert pyproj.CRS(LAS.info(tmp_path / "a.las", ReadOptions(crs="EPSG:25832")).crs).to_epsg() == 25832
    LAS.write(tmp_path / "b.las", LAS.read(tmp_path / "a.las", DEFAULT), WriteOptions())
    assert (tmp_path / "b.las").read_bytes() == (tmp_path / "a.las").read_bytes()


def test_damaged_keys():
    directory, doubles, _ = records({3072: 32767, 3075: 1, 3080: 9.0, 2048: 4258})
    for end in range(8, len(directory)):
        with pytest.raises(DataError, match="directory of 4 keys"):
            GeotiffKeys.parse(directory[:end], doubles, b"")
    assert 3080 not in GeotiffKeys.parse(directory, doubles[:7], b"").values
    with pytest.raises(DataError, match="directory of 0 keys"):
        GeotiffKeys.parse(b"", b"", b"")


@pytest.mark.parametrize("target", ["EPSG:25833", "EPSG:25833+7837"])
def test_a_reprojected_old_file_gets_keys_of_its_new_system(tmp_path, rng, target):
    make(tmp_path / "a.las", rng, SPELLED["transverse Mercator"][0])
    cloud = LAS.read(tmp_path / "a.las", ReadOptions(reproject=target))
    LAS.write(tmp_path / "b.las", cloud, WriteOptions())
    again = LAS.read(tmp_path / "b.las", DEFAULT)
    assert pyproj.CRS(again.crs) == pyproj.CRS(target)
    np.testing.assert_allclose(again.world_xyz(), cloud.world_xyz(), rtol=0, atol=5.1e-4)
    written = laspy.read(tmp_path / "b.las")
    assert written.header.version.minor == 2 and written.header.parse_crs() is not None
    assert {vlr.record_id for vlr in written.header.vlrs if vlr.user_id == "LASF_Projection"} == {34735}
    lonely = LAS.read(tmp_path / "a.las", ReadOptions(reproject="+proj=tmerc +lon_0=9.3 +ellps=GRS80"))
    with pytest.raises(DataError, match=r"b\.las.* 1\.2 .*like: none"):
        LAS.write(tmp_path / "b.las", lonely, WriteOptions())


def test_labels_of_an_old_file_carry_its_spelled_out_system_as_wkt(tmp_path, rng):
    make(tmp_path / "a.las", rng, SPELLED["Lambert with one parallel"][0])
    write_labelled(tmp_path / "a.las", tmp_path / "b.laz", make_labels)
    with laspy.open(tmp_path / "b.laz") as written:
        assert written.header.version.minor == 4
        assert written.header.parse_crs() == pyproj.CRS(LAS.info(tmp_path / "a.las", DEFAULT).crs)


def test_what_has_no_code_has_no_directory():
    assert GeotiffKeys.parse(pack_directory("EPSG:4258"), b"", b"").values == {1024: 2, 1025: 1, 2048: 4258}
    with pytest.raises(DataError, match="has no EPSG code"):
        pack_directory("+proj=tmerc +lon_0=9.3 +ellps=GRS80")

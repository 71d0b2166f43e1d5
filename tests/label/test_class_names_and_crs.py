"""Header of a labelled survey: names of the class codes, and the assigned coordinate reference system."""

import re

import laspy
import numpy as np
import pytest
from helpers.conf import base
from helpers.formats import make_labels, make_las
from helpers.wiring import REPOSITORY

from mlsroad_pipeline.algorithms.core.codings import CODE_NAMES
from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.formats.base import ReadOptions
from mlsroad_pipeline.formats.las.copc import write_copc
from mlsroad_pipeline.formats.las.header import LOOKUP, class_names, read_header
from mlsroad_pipeline.label.writer import write_labelled
from mlsroad_pipeline.surveys.parameters import LabelParameters


def header_of(path):
    with laspy.open(path) as reader:
        return reader.header


NAMES = {2: "ground", 64: "pole", 67: "street furniture"}


def test_names_of_codes_are_in_laz_and_copc_and_those_of_other_codes_are_kept(tmp_path, rng):
    """The layout of the specification: 256 records of a code and 15 characters."""
    make_las(tmp_path / "a.las", rng)  # names codes 2 and 3
    write_labelled(tmp_path / "a.las", tmp_path / "b.laz", make_labels, class_names=NAMES)
    write_copc(tmp_path / "b.laz", tmp_path / "b.copc.laz")
    for name in ("b.laz", "b.copc.laz"):
        found = header_of(tmp_path / name).vlrs.get("ClassificationLookupVlr")
        assert len(found) == 1
        record = read_header(tmp_path / name).find(LOOKUP).data
        assert len(record) == 256 * 16 and record[::16] == bytes(range(256))
        assert record[64 * 16 + 1 : 65 * 16] == b"pole".ljust(15, b"\0")
        assert record[67 * 16 + 1 : 68 * 16] == b"street furnitur"
        expected = {2: "ground", 3: "low\0low\0low\0abc", 64: "pole", 67: "street furnitur"}
        assert class_names(read_header(tmp_path / name)) == expected


def test_without_names_the_record_of_the_input_stays(tmp_path, rng):
    make_las(tmp_path / "a.las", rng)
    write_labelled(tmp_path / "a.las", tmp_path / "b.laz", make_labels)
    assert read_header(tmp_path / "b.laz").find(LOOKUP) == read_header(tmp_path / "a.las").find(LOOKUP)


@pytest.mark.parametrize(("version", "point_format"), [("1.2", 3), ("1.4", 7)])
@pytest.mark.parametrize("geotiff", [None, 25832])
def test_assigned_crs_replaces_that_of_the_file_without_moving_a_point(tmp_path, rng, version, point_format, geotiff):
    old = make_las(tmp_path / "a.las", rng, version=version, point_format=point_format, geotiff=geotiff)
    write_labelled(tmp_path / "a.las", tmp_path / "b.laz", make_labels, options=ReadOptions(crs="EPSG:28992"))
    new = laspy.read(tmp_path / "b.laz")
    assert new.header.parse_crs().to_epsg() == 28992 and new.header.global_encoding.wkt
    assert not new.header.vlrs.get("GeoKeyDirectoryVlr")
    assert np.array_equal(new.X, old.X) and np.array_equal(new.header.offsets, old.header.offsets)


def test_crs_of_a_sidecar_enters_a_header_without_one(tmp_path, rng):
    for geotiff, expected in ((None, 28992), (25832, 25832)):
        make_las(tmp_path / "a.las", rng, geotiff=geotiff)
        (tmp_path / "a.prj").write_text("EPSG:28992")
        write_labelled(tmp_path / "a.las", tmp_path / "b.laz", make_labels)
        assert header_of(tmp_path / "b.laz").parse_crs().to_epsg() == expected


def test_crs_that_cannot_be_is_an_error_of_one_line_before_anything_runs():
    with pytest.raises(ParameterError) as caught:
        LabelParameters("a.laz", "out", crs="RD New, Dutch")
    assert str(caught.value).startswith("label.crs 'RD New, Dutch' is not a coordinate reference system")
    assert "such as EPSG:28992" in str(caught.value) and "\n" not in str(caught.value)
    with pytest.raises(ParameterError, match=r"label\.crs 'EPSG:28992' and label\.read\.crs 'EPSG:25832' differ"):
        LabelParameters("a.laz", "out", crs="EPSG:28992", read={"crs": "EPSG:25832"})
    assert LabelParameters("a.laz", "out", crs="EPSG:28992").options().crs == "EPSG:28992"


def test_table_of_codes_in_the_manual_is_that_of_the_code():
    text = (REPOSITORY / "docs/formats.md").read_text(encoding="utf-8")
    rows = dict(re.findall(r"^\| (\d+) \| ([^|]+) \|", text[text.index("### Codes") :], re.MULTILINE))
    private = {
        config["asprs"]: name
        for name, config in base("classes")["schemes"]["road_inventory"]["classes"].items()
        if config["asprs"] >= 64
    }
    written = {code: name for code, name in CODE_NAMES.items() if code in schemes_codes()}
    assert {int(code): name for code, name in rows.items()} == {**written, **private}


def schemes_codes():
    """Return the codes that the scheme of the shipped models writes, with those of noise and of unlabelled points."""
    classes = base("classes")["schemes"]["road_inventory"]["classes"]
    return {config["asprs"] for config in classes.values()} | {1, 7}

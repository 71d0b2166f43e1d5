"""Checks before the labelling: paths of results, and what LAZ and copies cannot hold."""

import re
from contextlib import nullcontext

import laspy
import numpy as np
import plyfile
import pytest
from helpers.formats import make_labels

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.scenes.parameters import IngestParameters
from mlsroad_pipeline.formats.base import ReadOptions
from mlsroad_pipeline.label.checks import _check_exports, check_file, check_whole_numbers
from mlsroad_pipeline.label.runs import planned_paths
from mlsroad_pipeline.label.writer import write_labelled
from mlsroad_pipeline.surveys.files import Survey
from mlsroad_pipeline.surveys.parameters import LEAST_SCORES, LabelParameters
from mlsroad_pipeline.surveys.plan import plan_survey


def ply(path, **columns):
    path.parent.mkdir(parents=True, exist_ok=True)
    names = {"x": "f8", "y": "f8", "z": "f8", **columns}
    vertices = np.zeros(5, dtype=list(names.items()))
    plyfile.PlyData([plyfile.PlyElement.describe(vertices, "vertex")]).write(str(path))
    return path


def las(path, point_format=6, n=5):
    path.parent.mkdir(parents=True, exist_ok=True)
    data = laspy.LasData(laspy.LasHeader(version="1.4", point_format=point_format))
    data.x = np.arange(float(n))
    data.write(str(path))
    return path


def plan_of(root):
    files = Survey.at(root).listing().files
    return plan_survey({"survey": files}, {}, options=ReadOptions(), labels=False, ingest=IngestParameters())


def paths(root, out, **changes):
    return planned_paths(plan_of(root), out, LabelParameters(str(root), str(out), **changes))


def check(path, low=0.0, high=1.0, *, copc=False):
    plan = plan_of(path)
    row = {f"{end}_{axis}": value for axis in "xyz" for end, value in (("min", low), ("max", high))}
    check_file(plan.files[0], plan, row, copc=copc)


def test_all_results_of_a_survey_are_planned(tmp_path):
    las(tmp_path / "in/west/a.copc.laz"), ply(tmp_path / "in/b.ply")
    out = tmp_path / "out"
    names = {p.removeprefix(f"{out}/") for p in paths(tmp_path / "in", out, copc=True, coloured_ply=True)}
    assert names == {
        *("inventory.gpkg", "inventory.parquet", "inventory.qml", "report.html"),
        *("west/a.laz", "west/a.copc.laz", "west/a_classes.ply"),
        *("b.laz", "b.copc.laz", "b_classes.ply", "b.ply"),
    }
    more = {p.removeprefix(f"{out}/") for p in paths(tmp_path / "in", out, export=" DXF,geojson")} - names
    assert more == {"inventory.dxf", "inventory.geojson"}


@pytest.mark.parametrize("given", ["csv;dxf", ["dwg"], 3])
def test_an_unknown_format_is_named_with_the_known_ones(given):
    with pytest.raises(ParameterError, match=r"label\.export .*csv, geojson, flatgeobuf, shapefile, gml, dxf"):
        LabelParameters("in", "out", export=given)


def test_a_system_that_a_format_cannot_hold_ends_the_run_before_the_labelling():
    _check_exports(None, "a.las", ["csv", "flatgeobuf", "shapefile", "dxf"])
    with pytest.raises(DataError, match=r"a\.las: GeoJSON needs longitudes .* set label\.crs"):
        _check_exports(None, "a.las", ["geojson"])
    _check_exports("EPSG:25833+7837", "a.las", ["geojson", "csv"])


@pytest.mark.parametrize(
    ("names", "changes", "path"),
    [
        (("a.las", "a.ply"), {}, "a.laz"),
        (("a.copc.laz", "a.laz"), {}, "a.laz"),
        (("a.las", "a_classes.ply"), {"coloured_ply": True}, "a_classes.ply"),
    ],
)
def test_two_results_of_one_path_are_named(tmp_path, names, changes, path):
    for name in names:
        ply(tmp_path / "in" / name) if name.endswith("ply") else las(tmp_path / "in" / name, n=len(name))  # no copies
    with pytest.raises(ParameterError, match=rf"out/{path} would hold {names[1]} and {names[0]}") as caught:
        paths(tmp_path / "in", tmp_path / "out", **changes)
    assert len(str(caught.value).splitlines()) == 1


def test_a_result_is_never_a_file_of_the_survey(tmp_path):
    first, second = las(tmp_path / "a/x.laz"), las(tmp_path / "b/y.laz")
    with pytest.raises(ParameterError, match=rf"{first} is a file of the survey"):
        paths([str(first), str(second)], tmp_path)


def test_a_column_name_longer_than_that_of_las_is_named_as_by_the_writer(tmp_path):
    name = "a_column_with_a_name_of_34_letters"
    path = ply(tmp_path / "a.ply", **{name: "f4"})
    with pytest.raises(DataError, match=rf"a\.ply.*{name}.* 32 bytes"):
        check(path)
    with pytest.raises(DataError, match="32 bytes"):
        write_labelled(path, tmp_path / "out/a.laz", make_labels)


def test_coordinates_beyond_32_bits_are_named(tmp_path):
    path = ply(tmp_path / "a.ply")
    check(path, high=2_147_483.0)
    with pytest.raises(
        DataError, match=r"a\.ply: x is .* to 2147484, more than 2147484 from the first point.*scale of 0\.001"
    ):
        check(path, high=2_147_484.0)
    check(las(tmp_path / "b.las"), high=1e9)  # it keeps its own scale


@pytest.mark.parametrize(
    ("size", "refused"),
    [((40_000.0, 300.0, 12.0), False), ((40_000.0, 300.0, 12_000.0), True), ((140_000.0, 300.0, 900.0), True)],
)
def test_whole_numbers_that_cannot_be_metres_are_refused(size, refused):
    row = {f"{end}_{axis}": value for end in ("min", "max") for axis, value in zip("xyz", size, strict=True)}
    row |= {f"min_{axis}": 0.0 for axis in "xyz"}
    expected = pytest.raises(DataError, match=r"^a\.xyz: .* set label\.read\.units=millimetre")
    with expected if refused else nullcontext():
        check_whole_numbers(row, "a.xyz")


def test_waveforms_are_an_error_with_copc_alone(tmp_path):
    path = las(tmp_path / "a.las", point_format=9)
    check(path)
    with pytest.raises(DataError, match=r"a\.las has points of format 9 with waveforms.*label\.copc=false"):
        check(path, copc=True)


def test_a_confidence_that_cannot_be_kept_is_named(tmp_path):
    path = las(tmp_path / "a.las")
    data = laspy.read(path)
    for name, kind in (("confidence", "i2"), ("original_confidence", "f4")):
        data.add_extra_dim(laspy.ExtraBytesParams(name, kind))
    data.write(str(path))
    with pytest.raises(DataError, match=r"both confidence \(int16\) and original_confidence"):
        check(path)


def test_least_scores_by_kind():
    assert LabelParameters("in", "out").least_scores == {"pole": 0.3, "sign": 0.4, "vehicle": 0.4, "tree": 0.4}
    assert LabelParameters("in", "out", least_score=0.2).least_scores == dict.fromkeys(LEAST_SCORES, 0.2)
    found = LabelParameters("in", "out", least_score={"pole": 0.2}).least_scores
    assert found == {"pole": 0.2, "sign": 0.4, "vehicle": 0.4, "tree": 0.4}


@pytest.mark.parametrize(
    ("given", "told"), [(1.5, "1.5"), ("x", "'x'"), ({"lamp": 0.2}, "unknown kind 'lamp'"), ({"pole": True}, "True")]
)
def test_wrong_least_scores_are_named(given, told):
    with pytest.raises(ParameterError, match=re.escape(told)):
        LabelParameters("in", "out", least_score=given)

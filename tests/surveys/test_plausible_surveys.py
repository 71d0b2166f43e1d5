"""Plausible faults of surveys: times, units, withheld points; `inspect` and `label` say the same."""

import re

import laspy
import numpy as np
import pyproj
import pytest
from helpers.formats import make_labels, make_las
from helpers.las_rules import broken_rules
from helpers.plain_clouds import write
from typer.testing import CliRunner

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.quality.tables import chunk_from_arrays
from mlsroad_pipeline.algorithms.scenes.parameters import IngestParameters
from mlsroad_pipeline.algorithms.scenes.splits import SplitPart
from mlsroad_pipeline.commands.app import app
from mlsroad_pipeline.formats.base import ReadOptions
from mlsroad_pipeline.formats.registry import get_format
from mlsroad_pipeline.label.checks import check_headers, output_problems
from mlsroad_pipeline.label.writer import write_labelled
from mlsroad_pipeline.surveys.given_classes import GivenParameters
from mlsroad_pipeline.surveys.inspection import InspectParameters, inspect_survey
from mlsroad_pipeline.surveys.parameters import LabelParameters
from mlsroad_pipeline.surveys.plan import plan_labelling
from mlsroad_pipeline.surveys.reading import describe_file, find_corridor, read_and_cut

NEW = LabelParameters("", "").options()


def inspected(path, **read):
    files, unread = inspect_survey(InspectParameters(), root=str(path), read=read, problems_of=output_problems)
    return files, unread


def corridor_of(path, options=NEW, trajectory=None):
    found = describe_file(str(path), options=options, labels=False, windows=True)
    arrays = find_corridor(
        *([found["sample"]], [found["windows"]]),
        trajectory=trajectory,
        along=True,
        factors=found["info"]["factors"],
    )
    return found, arrays


# times


@pytest.fixture(scope="module")
def line_scanner():
    rng = np.random.default_rng(4)
    n = 20_000
    time = np.sort(rng.random(n)) * 8.0
    angle = 2 * np.pi * 100.0 * time
    reach = 6.0 + 2.0 * np.sin(3 * angle) + np.where(np.sin(angle) > 0, 3.0, 0.0)
    centre = np.column_stack([5.0 * time, 0 * time, 2.0 + 0 * time])
    beam = np.column_stack([0.3 * np.cos(angle), np.cos(angle), np.sin(angle)])
    return centre + reach[:, None] * beam / np.linalg.norm(beam, axis=1)[:, None], 4e8 + time


@pytest.mark.parametrize("share", [0.05, 0.5, 1.0])
@pytest.mark.parametrize("where", ["first", "scattered"])
@pytest.mark.parametrize("value", ["zero", "first", "inf", "nan", "huge"])
def test_times_that_are_no_measurements(tmp_path, line_scanner, share, where, value):
    xyz, time = line_scanner
    n = len(time)
    wrong = np.zeros(n, bool)
    k = int(share * n)
    rows = {"first": slice(0, k), "last": slice(n - k, n), "scattered": np.random.default_rng(0).permutation(n)[:k]}
    wrong[rows[where]] = True
    worst = {"zero": 0.0, "first": time[0], "inf": np.inf, "nan": np.nan, "huge": 1e300}[value]
    path = write(tmp_path / "a.las", xyz, gps_time=np.where(wrong, worst, time))
    found, arrays = corridor_of(path)
    notes = found["info"]["notes"].tolist()
    if share < 1:
        assert any("gps_time are infinite or shared" in note for note in notes), notes
    assert "trajectory" in arrays or "centre" in arrays
    if "trajectory" in arrays:
        assert np.isfinite(arrays["trajectory"]).all() and np.ptp(arrays["time"]) < 10
    cut = read_and_cut(
        str(path), arrays, options=NEW, labels=False, along=True, part=SplitPart(), start=0, stop=n, n_total=n, file=0,
        bin_length=1.0, time_gap=1.0,
    )  # fmt: skip
    assert cut["bins"]["counts"].sum() == n


# units


def test_units_follow_the_system_and_results_keep_them(tmp_path, rng):
    xyz = np.array([300_000.0, 60_000.0, 40.0]) + rng.random((70, 3)) * [50, 50, 9]
    cases = {
        "EPSG:2263": (1200 / 3937, 1200 / 3937),
        "EPSG:2263+6360": (1200 / 3937, 1200 / 3937),
        "EPSG:2263+5703": (1200 / 3937, 1.0),
        "EPSG:32618+6360": (1.0, 1200 / 3937),
        "EPSG:32618+8228": (1.0, 0.3048),
        "EPSG:2222": (0.3048, 0.3048),
        "+proj=tmerc +lat_0=40 +lon_0=-74 +ellps=GRS80 +units=us-ft": (1200 / 3937, 1200 / 3937),
        "+proj=utm +zone=18 +to_meter=0.01": (0.01, 0.01),
        "EPSG:32618": (1.0, 1.0),
    }
    for number, (crs, (flat, height)) in enumerate(cases.items()):
        for ending in ("las", "ply"):
            path = write(tmp_path / f"{number}.{ending}", xyz, crs)
            form = get_format(path)
            stored = form.read(path, ReadOptions()).world_xyz()
            np.testing.assert_allclose(stored, xyz, atol=1e-3)
            cloud = form.read(path, NEW)
            np.testing.assert_allclose(cloud.world_xyz(), stored * [flat, flat, height], atol=1e-6)
            info = form.info(path, NEW)
            assert any("are converted from units" in note for note in info.notes) == ((flat, height) != (1, 1)), crs
            system = pyproj.CRS.from_user_input(cloud.crs)
            assert {axis.unit_name for axis in system.axis_info} == {"metre"}, crs
            as_metres = form.read(path, ReadOptions(units="metre")).world_xyz()
            np.testing.assert_array_equal(as_metres, stored)
            target = tmp_path / f"out{number}" / f"{number}{ending}.laz"
            write_labelled(path, target, make_labels, options=NEW, native=False)
            result = laspy.read(target)
            np.testing.assert_allclose(result.xyz, stored, rtol=0, atol=1e-3 if flat > 0.1 else 0.06)
            assert result.header.parse_crs().equals(pyproj.CRS.from_user_input(crs), ignore_axis_order=True), crs
            assert broken_rules(target) == []


def test_heights_can_have_their_own_unit(tmp_path):
    path = write(tmp_path / "a.ply", [[1, 2, 10], [3, 4, 20]])
    cloud = get_format(path).read(path, ReadOptions(height_units="foot"))
    np.testing.assert_allclose(cloud.xyz, [[1, 2, 3.048], [3, 4, 6.096]])


@pytest.mark.parametrize(
    ("crs", "message"),
    [
        ("EPSG:4326", r"WGS 84 has coordinates in degrees; set label\.read\.reproject .* or label\.crs if it is wrong"),
        ("EPSG:4979", r"has coordinates in degrees"),
        ("EPSG:4326+5703", r"has coordinates in degrees"),
        ("+proj=longlat +datum=WGS84", r"has coordinates in degrees"),
        ("EPSG:4978", r"has geocentric coordinates"),
        ("+proj=geocent +datum=WGS84", r"has geocentric coordinates"),
    ],
)
@pytest.mark.parametrize("ending", ["laz", "ply", "txt"])
def test_systems_without_lengths_are_refused_before_any_point(tmp_path, crs, message, ending):
    path = write(tmp_path / f"a.{ending}", [[13.1, 52.1, 30], [13.2, 52.2, 31]], crs)
    parameters = LabelParameters(str(path), str(tmp_path / "out"))
    with pytest.raises(DataError, match=rf"a\.{ending}: its coordinate reference system .*{message}"):
        check_headers(plan_labelling(parameters, IngestParameters()), parameters)
    files, _ = inspected(path)
    assert any(text.startswith("label refuses it: ") for text in files[0].warnings)
    wanted = LabelParameters(str(path), str(tmp_path / "out"), read={"reproject": "EPSG:25833"})
    check_headers(plan_labelling(wanted, IngestParameters()), wanted)


def test_a_named_trajectory_must_lie_beside_a_file(tmp_path):
    path = write(tmp_path / "a.laz", [[1, 2, 3], [4, 5, 6]])
    wanted = LabelParameters(str(path), str(tmp_path / "out"), trajectory="path.csv")
    with pytest.raises(ParameterError, match=rf"^label\.trajectory: {tmp_path}/path\.csv does not exist; "):
        plan_labelling(wanted, IngestParameters())
    (tmp_path / "path.csv").write_text("gps_time,x,y,z\n0,1,2,3\n1,2,2,3\n", encoding="utf-8")
    assert plan_labelling(wanted, IngestParameters()).files[0].source.trajectory == str(tmp_path / "path.csv")


def test_trajectory_has_the_units_of_the_points(tmp_path, line_scanner):
    xyz, time = line_scanner
    path = write(tmp_path / "a.las", xyz / 0.3048 + [1e6, 2e5, 0], "EPSG:2222", gps_time=time)
    (tmp_path / "trajectory.csv").write_text(
        "time,x,y,z\n400000000,1000000,200000,6\n400000008,1000131.2336,200000,6\n"
    )
    _, arrays = corridor_of(path, trajectory=str(tmp_path / "trajectory.csv"))
    assert np.isclose(arrays["station"][-1], 40.0, atol=0.01)


# what results cannot hold


def test_what_results_cannot_hold_is_found_in_the_header(tmp_path, rng):
    n = 5
    xyz = rng.random((n, 3))
    cases = {
        "name": (
            {"a" * 33: np.zeros(n)},
            r"column name 'a{33}' is longer than the 32 bytes that LAS allows: shorten it",
        ),
        "many": (
            {f"c{i}": np.zeros(n, np.uint8) for i in range(400)},
            r"40\d extra dimensions .* of which LAS holds 341",
        ),
    }
    for name, (columns, message) in cases.items():
        path = tmp_path / f"{name}.npz"
        np.savez(path, xyz=xyz, **columns)
        parameters = LabelParameters(str(path), str(tmp_path / "out"))
        with pytest.raises(DataError, match=rf"{name}\.npz.*{message}"):
            check_headers(plan_labelling(parameters, IngestParameters()), parameters)
        assert [t for t in inspected(path)[0][0].warnings if t.startswith("label refuses it: ")]


def test_half_precision_is_stored_in_single(tmp_path, rng):
    path = tmp_path / "a.npz"
    np.savez(path, xyz=rng.random((5, 3)), half=np.arange(5, dtype=np.float16), intensity=np.ones(5, np.float16))
    write_labelled(path, tmp_path / "out" / "a.laz", make_labels, options=NEW)
    assert laspy.read(tmp_path / "out" / "a.laz")["half"].tolist() == [0, 1, 2, 3, 4]


def test_systems_that_proj_does_not_understand_are_refused(tmp_path, rng):
    path = tmp_path / "a.las"
    las = make_las(path, rng)
    las.header.vlrs.append(laspy.vlrs.known.WktCoordinateSystemVlr('PROJCS["by hand",GEOGCS["nothing"]]'))
    las.write(str(path))
    parameters = LabelParameters(str(path), str(tmp_path / "out"))
    with pytest.raises(DataError, match=r"a\.las: its coordinate reference system 'PROJCS.*is not understood"):
        check_headers(plan_labelling(parameters, IngestParameters()), parameters)
    given = LabelParameters(str(path), str(tmp_path / "out"), crs="EPSG:25832")
    check_headers(plan_labelling(given, IngestParameters()), given)


@pytest.mark.parametrize("where", [0, 2, -1])
@pytest.mark.parametrize("ending", ["ply", "npz", "e57"])
def test_inspect_tells_what_label_refuses_of_the_extent(tmp_path, rng, where, ending):
    xyz = rng.random((5, 3)) + [389_300, 5_819_700, 34]
    xyz[where] = 0
    (found,), _ = inspected(write(tmp_path / f"a.{ending}", xyz))
    refused = [text for text in found.warnings if text.startswith("label refuses it: ")]
    assert len(refused) == 1
    assert re.match(r"label refuses it: y is 0 to 58197\d\d.*remove stray points or set label\.read\.units", refused[0])


def test_feet_of_a_site_grid_are_converted(tmp_path, rng):
    path = write(tmp_path / "a.npz", rng.random((5, 3)) * 100)
    (tmp_path / "a.prj").write_text('LOCAL_CS["site",UNIT["US survey foot",0.304800609601219]]')
    (found,), _ = inspected(path)
    assert any("coordinates are converted from units of 0.3048006096 m" in text for text in found.warnings)


def test_unnamed_colours_and_extra_dimensions_named_rgb_are_labelled(tmp_path, rng):
    path = tmp_path / "a.pts"
    rows = np.column_stack([rng.random((80, 3)) * 9, np.arange(80) - 2048, rng.integers(0, 255, (80, 3))])
    np.savetxt(path, rows, fmt="%.3f %.3f %.3f %d %d %d %d", header="80", comments="")
    assert "rgb" in describe_file(str(path), options=NEW, labels=False, windows=False)["sample"]
    las = laspy.create(point_format=1, file_version="1.2")
    las.add_extra_dim(laspy.ExtraBytesParams("rgb", "u1"))
    las.x = las.y = las.z = np.arange(5.0)
    las.write(tmp_path / "b.las")
    found = describe_file(str(tmp_path / "b.las"), options=NEW, labels=False, windows=False)
    assert "rgb" not in found["sample"]


# withheld


@pytest.mark.parametrize("ending", ["las", "ply", "npz"])
@pytest.mark.parametrize("labels", [False, True])
def test_withheld_points_are_not_used(tmp_path, rng, ending, labels):
    withheld = (np.arange(90) % 3 == 0).astype(np.uint8)
    path = write(tmp_path / f"a.{ending}", rng.random((90, 3)) * 9, withheld=withheld, label=np.ones(90, np.uint8))
    _, arrays = corridor_of(path)
    cut = read_and_cut(
        str(path), arrays, options=NEW, labels=labels, along=True, part=SplitPart(), start=30, stop=90, n_total=90,
        file=0, bin_length=1.0, time_gap=1.0,
    )  # fmt: skip
    rows = np.sort(cut["points"]["column.row"])
    np.testing.assert_array_equal(rows, [row for row in range(30, 90) if row % 3])


def test_inspect_warns_of_a_file_of_withheld_points(tmp_path, rng):
    path = write(tmp_path / "a.npz", rng.random((90, 3)) * 9, withheld=np.ones(90, np.uint8))
    write(tmp_path / "b.npz", rng.random((90, 3)) * 9)
    assert (
        "all points are flagged withheld or have a class of noise: none is labelled, and label refuses a survey of such files alone"
        in (inspected(path)[0][0].warnings)
    )
    files, _ = inspected(tmp_path)
    assert len(files) == 2
    assert not any(text.startswith("label refuses it") for file in files for text in file.warnings)


# noise


@pytest.mark.parametrize("noise", [7, 18])
@pytest.mark.parametrize(
    ("given", "used"),
    [
        ({}, False),
        ({"keep_classes": True}, True),  # `label` excludes it as the class map says
        ({"keep_classes": True, "keep": (2, 6)}, False),
        ({"keep_classes": True, "keep": (7, 18)}, True),
        ({"keep_classes": True, "classes": "semantickitti"}, True),
    ],
)
def test_points_with_a_class_of_noise_are_not_used(tmp_path, rng, noise, given, used):
    codes = np.where(np.arange(90) % 3 == 0, noise, 2).astype(np.uint8)
    withheld = (np.arange(90) < 9).astype(np.uint8)
    path = write(tmp_path / "a.las", rng.random((90, 3)) * 9, classification=codes, withheld=withheld)
    _, arrays = corridor_of(path)
    cut = read_and_cut(
        str(path), arrays, options=NEW, labels=False, along=True, part=SplitPart(), start=0, stop=90, n_total=90,
        file=0, bin_length=1.0, time_gap=1.0, given=GivenParameters.from_config(given),
    )  # fmt: skip
    rows = np.sort(cut["points"]["column.row"])
    np.testing.assert_array_equal(rows, [row for row in range(9, 90) if row % 3 or used])
    assert chunk_from_arrays(cut["quality"]).n_noise == (0 if used else 27)
    assert any(text.startswith("27 points have a class of noise") for text in inspected(path)[0][0].warnings)


def test_inspect_warns_of_a_file_of_noise(tmp_path, rng):
    path = write(tmp_path / "a.las", rng.random((90, 3)) * 9, classification=np.full(90, 18, np.uint8))
    assert any("or have a class of noise: none is labelled" in text for text in inspected(path)[0][0].warnings)


# warnings of bounds and counts


def test_label_and_inspect_tell_the_same(tmp_path, rng):
    path = tmp_path / "a.las"
    las = make_las(path, rng, n=300, extras=False)
    data = bytearray(path.read_bytes())
    data[179:227] = bytes(48)
    data[247:255] = (200).to_bytes(8, "little")
    path.write_bytes(data)
    told = describe_file(str(path), options=NEW, labels=False, windows=False)["info"]
    assert len(las) == told["n_points"][0] == 300
    warnings = inspected(path)[0][0].warnings
    for note in told["notes"]:
        assert note in warnings
    assert any(
        "its header states the bounds [0.0, 0.0, 0.0] to [0.0, 0.0, 0.0], its points have" in t for t in warnings
    )


@pytest.mark.parametrize("far", ["1e30", "1e155", "1e300", "-1e308"])
def test_inspect_reports_coordinates_beyond_all_scales(tmp_path, rng, far):
    rows = [" ".join(f"{value:.3f}" for value in row) for row in rng.random((300, 3)) * 20]
    for axis in range(3):
        place = ["3.0"] * 3
        place[axis] = far
        rows.append(" ".join(place))
    (tmp_path / "far.xyz").write_text("\n".join(rows) + "\n", encoding="utf-8")
    result = CliRunner().invoke(app, ["inspect", str(tmp_path / "far.xyz"), "-o", str(tmp_path / "out")])
    assert result.exit_code == 0, result.output
    assert "stray points, or units other than metres" in " ".join(result.output.split())
    assert "not drawn: far.xyz" in (tmp_path / "out" / "inspection.html").read_text(encoding="utf-8")

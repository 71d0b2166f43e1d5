"""`label` from end to end: surveys that the package has never seen, in every format, and what becomes of them."""

import gzip
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import geopandas as gpd
import laspy
import numpy as np
import open3d
import pyogrio
import pytest
import yaml
from references_wiring import REPOSITORY, label, last_line, shared_run, stage_counts, with_models

from mlsroad_pipeline.algorithms.point_cloud import PointCloud
from mlsroad_pipeline.datasets.formats.kitti import KittiFormat
from mlsroad_pipeline.datasets.formats.las import LasFormat
from mlsroad_pipeline.datasets.formats.options import ReadOptions, WriteOptions
from mlsroad_pipeline.datasets.formats.ply import PlyFormat
from mlsroad_pipeline.datasets.formats.text import TextFormat

pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]

N_POINTS = 9000
UNCLASSIFIED, NOISE = 1, 7


@pytest.fixture(scope="module")
def shared(tmp_path_factory):
    return shared_run(tmp_path_factory)


@pytest.fixture(scope="module")
def project(shared, tmp_path_factory):
    return with_models(shared, tmp_path_factory.mktemp("labelling"))


@pytest.fixture(scope="module")
def cloud(shared):
    """The first points of a survey that the model was not trained on, with colour, intensity and time but no labels."""
    path = shared / "data/01_raw/simulated/test/survey.laz"
    found = LasFormat().read(path, ReadOptions(only=("rgb", "intensity", "gps_time", "scanner")), stop=N_POINTS)
    return PointCloud(found.xyz, found.columns, found.origin, found.crs, "cut")


@pytest.fixture(scope="module")
def survey(cloud, tmp_path_factory):
    """The same points as LAZ."""
    path = tmp_path_factory.mktemp("survey") / "street.laz"
    LasFormat().write(path, cloud, WriteOptions(like="none"))
    return path


@pytest.fixture(scope="module")
def labelled(project, survey, tmp_path_factory):
    """The survey, labelled once."""
    return label(project, survey, tmp_path_factory.mktemp("out") / "new" / "folder")


def scheme(name="road_inventory"):
    configured = yaml.safe_load((REPOSITORY / "conf/base/parameters_classes.yml").read_text(encoding="utf-8"))
    return configured["classes"]["schemes"][name]


def asprs_codes():
    return {spec["asprs"] for spec in scheme()["classes"].values()} | {UNCLASSIFIED, NOISE}


def check_labels(las, n_points):
    codes, confidence = np.asarray(las.classification), np.asarray(las["confidence"])
    assert len(codes) == n_points
    assert set(np.unique(codes).tolist()) <= asprs_codes()
    assert confidence.dtype == np.float32 and confidence.min() >= 0 and confidence.max() <= 1
    return codes, confidence


def check_same_points(written, original):
    """Every dimension of the original is in the result, in its place."""
    for name in original.point_format.dimension_names:
        if name in ("classification", "scan_angle_rank", "raw_classification"):
            continue
        assert np.array_equal(np.asarray(written[name]), np.asarray(original[name])), name
    for axis in "XYZ":
        assert np.array_equal(written[axis], original[axis])
    assert np.array_equal(written.header.scales, original.header.scales)
    assert np.array_equal(written.header.offsets, original.header.offsets)


def test_laz_keeps_every_point_and_attribute_and_gains_class_and_confidence(labelled, survey):
    written, original = laspy.read(labelled / "street.laz"), laspy.read(survey)
    check_same_points(written, original)
    codes, confidence = check_labels(written, N_POINTS)
    assert len(np.unique(codes)) >= 4 and confidence.mean() > 0.5
    assert written.header.parse_crs().to_epsg() == original.header.parse_crs().to_epsg() == 25833


def test_classes_are_mostly_those_that_the_simulator_put_there(labelled, shared):
    path = shared / "data/01_raw/simulated/test/survey.laz"
    truth = np.asarray(laspy.read(path)["label"])[:N_POINTS]
    codes = np.asarray(laspy.read(labelled / "street.laz").classification)
    assert (codes[np.isin(truth, range(1, 8))] == 11).mean() > 0.8  # paved ground
    assert (codes[truth == 20] == 6).mean() > 0.5  # building


def test_inventory_opens_in_its_system_and_lies_where_the_points_lie(labelled, survey):
    path = labelled / "inventory.gpkg"
    layers = set(pyogrio.list_layers(path)[:, 0])
    assert {"objects", "poles", "signs", "trees", "vehicles"} <= layers
    objects = gpd.read_file(path, layer="objects")
    assert objects.crs.to_epsg() == 25833
    las = laspy.read(survey)
    assert len(objects) > 0
    assert objects["x"].between(las.x.min(), las.x.max()).all() and objects["y"].between(las.y.min(), las.y.max()).all()
    assert set(objects["method"]) == {"detrended_forest"}
    assert all(re.fullmatch(r"mlsroad-detrended_forest \d+", version) for version in objects["model_version"])
    assert objects["score"].between(0, 1).all() and (objects["point_count"] > 0).all()
    assert objects["station"].notna().all()  # no trajectory lies beside the points: the path comes from their times


def test_geoparquet_holds_the_objects_of_the_geopackage(labelled):
    objects = gpd.read_file(labelled / "inventory.gpkg", layer="objects")
    table = gpd.read_parquet(labelled / "inventory.parquet")
    assert table.crs == objects.crs
    assert table["object_id"].tolist() == objects["object_id"].tolist()
    assert table.geometry.geom_equals(objects.geometry).all()
    np.testing.assert_array_equal(table["height"], objects["height"])


def test_report_tells_points_files_model_and_objects(labelled):
    page = (labelled / "report.html").read_text(encoding="utf-8")
    text = re.sub(r"<[^>]+>", " ", page).replace(",", "").replace("\u202f", "").replace("\u2009", "")
    assert str(N_POINTS) in text.replace(" ", "")
    assert "mlsroad-detrended_forest" in text and "street.laz" in text and "inventory.gpkg" in page
    n_objects = len(gpd.read_file(labelled / "inventory.gpkg", layer="objects"))
    assert re.search(rf"\b{n_objects}\b", text)


def test_labelling_again_recomputes_nothing_and_changes_no_byte(project, labelled, survey, caplog):
    with caplog.at_level("INFO", logger="mlsroad_pipeline"):
        label(project, survey, labelled)  # may compute: another test may have used the stores
    before = {path.name: path.read_bytes() for path in labelled.iterdir()}
    caplog.clear()
    with caplog.at_level("INFO", logger="mlsroad_pipeline"):
        label(project, survey, labelled)
    counts = stage_counts(caplog.messages)
    assert set(counts) == {"files", "corridors", "pieces", "results", "written"}
    assert all(computed == 0 and valid > 0 for computed, valid in counts.values()), counts
    assert {path.name: path.read_bytes() for path in labelled.iterdir()} == before


def test_a_deleted_result_is_written_again_with_the_same_bytes(project, labelled, survey):
    before = (labelled / "street.laz").read_bytes()
    (labelled / "street.laz").unlink()
    label(project, survey, labelled)
    assert (labelled / "street.laz").read_bytes() == before


def test_two_workers_give_the_bytes_of_one(shared, labelled, survey, tmp_path):
    project = with_models(shared, tmp_path / "project")
    found = label(project, survey, tmp_path / "out", execution={"backend": "loky", "n_workers": 2})
    assert (found / "street.laz").read_bytes() == (labelled / "street.laz").read_bytes()


def test_output_in_a_folder_that_is_no_part_of_the_survey_may_lie_inside_it(project, survey, tmp_path):
    folder = tmp_path / "survey"
    (folder / "west").mkdir(parents=True)
    (folder / "west" / "street.laz").write_bytes(survey.read_bytes())
    out = folder / "labelled"
    label(project, folder, out)
    first = (out / "west" / "street.laz").read_bytes()
    for copy in ("street.copc.laz", "street_classes.ply"):
        (out / "west" / copy).write_bytes(b"")
    label(project, folder, out)  # what the first run wrote is no survey
    assert (out / "west" / "street.laz").read_bytes() == first
    assert [p.relative_to(out).as_posix() for p in sorted(out.rglob("street.l*"))] == ["west/street.laz"]


def test_subfolders_are_mirrored_and_each_is_a_drive_of_its_own(project, survey, cloud, tmp_path):
    folder = tmp_path / "survey"
    for name, part in (("north/a.laz", slice(0, 4000)), ("south/deep/a.laz", slice(4000, N_POINTS))):
        (folder / name).parent.mkdir(parents=True)
        LasFormat().write(folder / name, cloud.select(np.arange(N_POINTS)[part]), WriteOptions(like="none"))
    out = label(project, folder, tmp_path / "out")
    for name in ("north/a.laz", "south/deep/a.laz"):
        check_same_points(laspy.read(out / name), laspy.read(folder / name))
    found = gpd.read_file(out / "inventory.gpkg", layer="objects")
    assert found["object_id"].is_unique


def test_tables_and_pictures_beside_the_points_are_no_points(shared, project, tmp_path, caplog):
    folder = shared / "data/01_raw/simulated/test"  # with trajectory.csv, objects.csv, images and calibration
    out = label(project, folder, tmp_path / "out")
    inventory = [f"inventory.{ending}" for ending in ("gpkg", "parquet", "qml")]
    assert [path.name for path in sorted(out.iterdir())] == [*inventory, "report.html", "survey.laz"]
    said = [record.getMessage() for record in caplog.records if "objects.csv" in record.getMessage()]
    assert len(said) == 1 and "Left out" in said[0]
    objects = gpd.read_file(out / "inventory.gpkg", layer="objects")
    assert objects["station"].notna().all()  # the trajectory was found
    assert "trajectory" in set(pyogrio.list_layers(out / "inventory.gpkg")[:, 0])


def written_as(form, name, cloud, folder, **options):
    path = folder / name
    form.write(path, cloud, WriteOptions(**options))
    return path


@pytest.mark.parametrize("kind", ["ply.gz", "txt", "csv.gz", "bin", "las"])
def test_formats_keep_their_points_and_their_own_form(project, cloud, labelled, tmp_path, kind):
    source = tmp_path / "in"
    source.mkdir()
    form = {"ply.gz": PlyFormat(), "bin": KittiFormat(), "las": LasFormat()}.get(kind, TextFormat())
    if kind == "bin":  # KITTI has no place for the world
        cloud = PointCloud(cloud.xyz.astype(np.float32), {"intensity": cloud["intensity"]}, np.zeros(3))
    name = f"street.{kind}"
    form.write(source / name, cloud, WriteOptions(like="none"))
    out = label(project, source / name, tmp_path / "out")
    las = laspy.read(out / "street.laz")
    codes, _ = check_labels(las, N_POINTS)
    assert np.abs(las.xyz - cloud.world_xyz()).max() <= 0.0006
    if kind == "las":
        return
    if kind == "bin":
        own = np.fromfile(out / "street.label", dtype="<u4")
        assert np.array_equal(own, codes)
    else:
        again = form.read(out / name, ReadOptions())
        assert np.array_equal(again["classification"].astype(np.uint8), codes)
        assert np.allclose(again["confidence"], las["confidence"], atol=1e-6)
        assert np.array_equal(again["rgb"], cloud["rgb"])
        same = np.asarray(laspy.read(labelled / "street.laz").classification) == codes
        assert same.mean() > 0.97  # the same points, up to the digits of the format


def test_copies_for_viewers_hold_the_points_of_the_result(project, survey, tmp_path):
    out = label(project, survey, tmp_path / "out", copc=True, coloured_ply=True)
    result = laspy.read(out / "street.laz")
    with laspy.CopcReader.open(out / "street.copc.laz") as reader:
        tree = reader.query()
        assert reader.header.parse_crs().to_epsg() == 25833
    rows, cells = (np.lexsort([np.asarray(p[name]) for name in ("gps_time", "Z", "Y", "X")]) for p in (result, tree))
    for name in result.point_format.dimension_names:
        np.testing.assert_array_equal(np.asarray(result[name])[rows], np.asarray(tree[name])[cells], err_msg=name)
    picture = out / "street_classes.ply"
    seen = open3d.t.io.read_point_cloud(str(picture))
    origin = re.search(rb"comment origin (\S+) (\S+) (\S+)", picture.read_bytes()[:1000])
    assert origin is not None
    world = seen.point.positions.numpy().astype(np.float64) + np.array(origin.groups(), dtype=np.float64)
    np.testing.assert_allclose(world, result.xyz, rtol=0, atol=1e-3)  # single precision beside its origin
    np.testing.assert_array_equal(seen.point["classification"].numpy()[:, 0], result.classification)
    np.testing.assert_array_equal(seen.point["confidence"].numpy()[:, 0], result["confidence"])
    colours = np.unique(np.column_stack([result.classification, seen.point.colors.numpy()]), axis=0)
    assert len(colours) == len(np.unique(result.classification))  # one colour a class
    before = {path.name: path.read_bytes() for path in out.iterdir()}
    (out / "street.copc.laz").unlink()
    label(project, survey, out, copc=True, coloured_ply=True)
    assert {path.name: path.read_bytes() for path in out.iterdir()} == before


def test_survey_without_colour_gets_the_forest_without_it_and_is_told_so_once(project, cloud, tmp_path, caplog):
    path = tmp_path / "plain.laz"
    LasFormat().write(path, cloud.without_columns(["rgb"]), WriteOptions(like="none"))
    out = label(project, path, tmp_path / "out")
    check_labels(laspy.read(out / "plain.laz"), N_POINTS)
    said = [r.getMessage() for r in caplog.records if r.levelname == "WARNING" and "no rgb" in r.getMessage()]
    assert len(said) == 1, said
    assert "has no rgb" in (out / "report.html").read_text(encoding="utf-8")


def test_classes_of_a_coarser_scheme_are_written_as_private_codes(project, survey, tmp_path):
    out = label(project, survey, tmp_path / "out", scheme="tomic2019")
    codes = np.unique(np.asarray(laspy.read(out / "street.laz").classification))
    assert codes.min() >= 64 and codes.max() < 64 + len(scheme("tomic2019")["classes"])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"survey": ""}, r"label\.survey is not set: kedro run --pipeline=label --params=label\.survey="),
        ({"output": ""}, r"label\.output is not set"),
        ({"survey": "nowhere.laz"}, r"nowhere\.laz does not exist"),
        ({"method": "luck"}, r"method 'luck'.*detrended_forest|no model 'mlsroad-luck'"),
        ({"model": 99}, r"mlsroad-detrended_forest.*version 99"),
        ({"model": "newest"}, r"label\.model.*'newest'|version 'newest'"),
        ({"scheme": "martian"}, r"label\.scheme 'martian' is not configured"),
        ({"scheme": "luo2016"}, r"class '.*' of scheme 'road_inventory' falls into 2 classes of scheme 'luo2016'"),
        ({"inventory": {"poel": {}}}, r"poel"),
        ({"read": {"colums": {}}}, r"colums"),
    ],
)
def test_wrong_parameters_end_with_a_line_that_names_them(project, survey, tmp_path, changes, message):
    given = {"survey": survey, "output": tmp_path / "out", **changes}
    with pytest.raises(Exception) as caught:  # the line that the user reads is what counts
        label(project, given.pop("survey"), given.pop("output"), **given)
    assert re.search(message, last_line(caught.value)), last_line(caught.value)
    assert not (tmp_path / "out").exists()


def test_output_that_cannot_be_made_is_an_error_before_anything_is_computed(project, survey, tmp_path, caplog):
    (tmp_path / "file").write_text("not a folder")
    with caplog.at_level("INFO", logger="mlsroad_pipeline"), pytest.raises(Exception) as caught:
        label(project, survey, tmp_path / "file" / "out")
    assert f"label.output: {tmp_path}/file/out cannot be written" in last_line(caught.value)
    assert not stage_counts(caplog.messages)


@pytest.mark.parametrize("given", [".", "./", "../survey"])
def test_output_equal_to_the_input_is_an_error(project, survey, tmp_path, given):
    folder = tmp_path / "survey"
    folder.mkdir()
    (folder / "street.laz").write_bytes(survey.read_bytes())
    with pytest.raises(Exception) as caught:
        label(project, folder, folder / given)
    assert "label.output is a folder of the survey itself" in last_line(caught.value)
    assert [path.name for path in folder.iterdir()] == ["street.laz"]


def test_amsterdam_tile_keeps_all_it_had(project, real_data, tmp_path):
    (path,) = sorted(real_data("amsterdam").glob("*.laz"))
    out = label(project, path, tmp_path / "out")
    written, original = laspy.read(out / path.name), laspy.read(path)
    check_same_points(written, original)
    check_labels(written, len(original.points))
    assert [v.record_id for v in written.header.vlrs if v.user_id == "LASF_Projection"] == [
        v.record_id for v in original.header.vlrs if v.user_id == "LASF_Projection"
    ]


def test_jakarto_file_keeps_all_it_had_though_it_has_no_colour(project, real_data, tmp_path):
    (path,) = sorted(real_data("jakarto").glob("*.la[sz]"))
    out = label(project, path, tmp_path / "out")
    written, original = laspy.read(out / f"{path.stem}.laz"), laspy.read(path)
    check_same_points(written, original)
    check_labels(written, len(original.points))


def test_killed_labelling_goes_on_where_it_stopped_with_the_bytes_of_an_undisturbed_one(shared, tmp_path, caplog):
    project = with_models(shared, tmp_path / "project")
    survey = shared / "data/01_raw/simulated/test/survey.laz"
    whole = label(with_models(shared, tmp_path / "other"), survey, tmp_path / "whole", ingest={"scene_length": 5.0})
    results = project / "data/02_intermediate/label/results"
    command = [
        *(sys.executable, "-W", "ignore", "-m", "kedro", "run", "--pipeline=label"),
        f"--params=label.survey={survey},label.output={tmp_path / 'out'},ingest.scene_length=5.0,"
        "execution.backend=sequential",
    ]
    environment = {**os.environ, "PYTHONPATH": str(REPOSITORY / "src")}
    with (tmp_path / "log").open("wb") as log:
        process = subprocess.Popen(
            command, cwd=project, env=environment, stdout=log, stderr=log, start_new_session=True
        )
        deadline = time.monotonic() + 300
        while len(list(results.glob("*/record.json"))) < 3 and time.monotonic() < deadline and process.poll() is None:
            time.sleep(0.005)
        os.killpg(process.pid, signal.SIGKILL)
        assert process.wait() == -signal.SIGKILL, (tmp_path / "log").read_text()[-2000:]
    done = len(list(results.glob("*/record.json")))
    assert done >= 3
    assert not (tmp_path / "out" / "survey.laz").exists()
    with caplog.at_level("INFO", logger="mlsroad_pipeline"):
        label(project, survey, tmp_path / "out", ingest={"scene_length": 5.0})
    counts = stage_counts(caplog.messages)
    assert counts["results"][1] >= done and counts["results"][0] > 0
    assert counts["pieces"][0] == 0
    assert (tmp_path / "out" / "survey.laz").read_bytes() == (whole / "survey.laz").read_bytes()


def test_gzip_text_is_read_without_being_unpacked_first(project, cloud, tmp_path):
    folder = tmp_path / "in"
    folder.mkdir()
    text = "\n".join(f"{x:.3f} {y:.3f} {z:.3f}" for x, y, z in cloud.xyz[:3000].tolist())
    Path(folder / "block.xyz.gz").write_bytes(gzip.compress(text.encode()))
    out = label(project, folder, tmp_path / "out", read={"columns": {"x": 0, "y": 1, "z": 2}, "header": False})
    check_labels(laspy.read(out / "block.laz"), 3000)
    assert gzip.decompress((out / "block.xyz.gz").read_bytes()).count(b"\n") == 3000

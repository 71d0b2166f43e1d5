"""`label` on every format: the result has the points and the layout of the input."""

import gzip
import re
from pathlib import Path

import laspy
import numpy as np
import open3d
import pytest
from helpers.labelled import N_POINTS, check_labels, check_same_points
from helpers.wiring import contents, label

from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.formats.base import ReadOptions, WriteOptions
from mlsroad_pipeline.formats.kitti import KittiFormat
from mlsroad_pipeline.formats.las.format import LasFormat
from mlsroad_pipeline.formats.ply.format import PlyFormat
from mlsroad_pipeline.formats.text.format import TextFormat

pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]


@pytest.mark.parametrize("kind", ["ply.gz", "txt", "csv.gz", "bin", "las"])
def test_formats_keep_their_points_and_their_own_form(label_project, cloud, labelled, tmp_path, kind):
    source = tmp_path / "in"
    source.mkdir()
    form = {"ply.gz": PlyFormat(), "bin": KittiFormat(), "las": LasFormat()}.get(kind, TextFormat())
    if kind == "bin":  # KITTI has no place for the world
        cloud = PointCloud(cloud.xyz.astype(np.float32), {"intensity": cloud["intensity"]}, np.zeros(3))
    name = f"street.{kind}"
    form.write(source / name, cloud, WriteOptions(like="none"))
    out = label(label_project, source / name, tmp_path / "out")
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


def test_copies_for_viewers_hold_the_points_of_the_result(label_project, survey, tmp_path):
    out = label(label_project, survey, tmp_path / "out", copc=True, coloured_ply=True)
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
    before = contents(out)
    (out / "street.copc.laz").unlink()
    label(label_project, survey, out, copc=True, coloured_ply=True)
    assert contents(out) == before


def test_amsterdam_tile_keeps_all_it_had(label_project, real_data, tmp_path):
    (tile,) = sorted(real_data("amsterdam").glob("*.laz"))
    original, path = laspy.read(tile), tmp_path / tile.name
    original.points = original.points[:40_000]  # of 450,000; the records of the header are those of the tile
    original.write(path)
    out = label(label_project, path, tmp_path / "out")
    written, original = laspy.read(out / path.name), laspy.read(path)
    check_same_points(written, original)
    check_labels(written, len(original.points))
    assert [v.record_id for v in written.header.vlrs if v.user_id == "LASF_Projection"] == [
        v.record_id for v in original.header.vlrs if v.user_id == "LASF_Projection"
    ]


def test_jakarto_file_keeps_all_it_had_though_it_has_no_colour(label_project, real_data, tmp_path):
    (path,) = sorted(real_data("jakarto").glob("*.la[sz]"))
    out = label(label_project, path, tmp_path / "out")
    written, original = laspy.read(out / f"{path.stem}.laz"), laspy.read(path)
    check_same_points(written, original)
    check_labels(written, len(original.points))


def test_gzip_text_is_read_without_being_unpacked_first(label_project, cloud, tmp_path):
    folder = tmp_path / "in"
    folder.mkdir()
    text = "\n".join(f"{x:.3f} {y:.3f} {z:.3f}" for x, y, z in cloud.xyz[:3000].tolist())
    Path(folder / "block.xyz.gz").write_bytes(gzip.compress(text.encode()))
    out = label(label_project, folder, tmp_path / "out", read={"columns": {"x": 0, "y": 1, "z": 2}, "header": False})
    check_labels(laspy.read(out / "block.laz"), 3000)
    assert gzip.decompress((out / "block.xyz.gz").read_bytes()).count(b"\n") == 3000

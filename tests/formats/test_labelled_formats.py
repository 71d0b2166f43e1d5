"""Labelled surveys that are no LAS: what each format keeps, and where its labels go."""

import gzip

import laspy
import numpy as np
import open3d
import pandas as pd
import plyfile
import pyarrow as pa
import pyarrow.parquet as pq
import pyproj
import pytest
from helpers.formats import (
    check_written_labels,
    make_labels,
    read_text_slowly,
)

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.formats.base import ReadOptions
from mlsroad_pipeline.formats.registry import get_format
from mlsroad_pipeline.label.writer import write_labelled


@pytest.mark.parametrize("name", ["a.csv", "a.txt.gz"])
def test_text_keeps_its_rows(tmp_path, rng, name):
    values = rng.normal(size=(50, 4)).round(5) * [1, 1, 1, 9]
    rows = [",".join(f"{v:.7g}" for v in row) for row in values]
    text = "# made by hand\nx,y,z,confidence\n" + "\r\n".join(rows)
    source = tmp_path / name
    source.write_bytes(gzip.compress(text.encode()) if name.endswith("gz") else text.encode())
    out = tmp_path / "out"
    assert write_labelled(source, out / "a.laz", make_labels, chunk_size=13) == [out / "a.laz", out / name]
    raw = (out / name).read_bytes()
    lines = (gzip.decompress(raw) if name.endswith("gz") else raw).decode().splitlines()
    codes, confidence, objects = make_labels(0, 50)
    assert lines[:2] == ["# made by hand", "x,y,z,original_confidence,classification,confidence,object_id"]
    assert [line.rsplit(",", 3)[0] for line in lines[2:]] == rows
    added = read_text_slowly(out / name, ",", 2)[:, 4:]
    np.testing.assert_array_equal(added[:, 0], codes)
    np.testing.assert_array_equal(added[:, 1].astype(np.float32), confidence)
    np.testing.assert_array_equal(added[:, 2], objects)
    las = laspy.read(out / "a.laz")
    check_written_labels(las)
    read = read_text_slowly(source, ",", 2)
    np.testing.assert_allclose(las.xyz, read[:, :3], rtol=0, atol=0.000501)
    np.testing.assert_array_equal(las["original_confidence"], read[:, 3])
    write_labelled(source, tmp_path / "again" / "a.laz", make_labels)
    assert (tmp_path / "again" / name).read_bytes() == raw
    assert (tmp_path / "again" / "a.laz").read_bytes() == (out / "a.laz").read_bytes()


@pytest.mark.parametrize(("text", "order"), [(True, "="), (False, "<"), (False, ">")])
def test_ply_keeps_its_elements(tmp_path, rng, text, order):
    fields = [
        ("x", "f8"),
        ("y", "f8"),
        ("z", "f8"),
        ("red", "u1"),
        ("green", "u1"),
        ("blue", "u1"),
        ("classification", "i2"),
    ]
    table = np.zeros(40, dtype=fields)
    for name, kind in fields:
        table[name] = rng.normal(size=40) if kind == "f8" else rng.integers(0, 256, 40)
    face = np.array([([0, 1, 2],), ([1, 2, 3, 4],)], dtype=[("vertex_indices", "O")])
    elements = [plyfile.PlyElement.describe(table, "vertex"), plyfile.PlyElement.describe(face, "face")]
    source = tmp_path / "a.ply"
    plyfile.PlyData(elements, text=text, byte_order=order, comments=["crs " + pyproj.CRS(28992).to_wkt()]).write(source)
    out = tmp_path / "out"
    assert write_labelled(source, out / "a.laz", make_labels, chunk_size=13) == [out / "a.laz", out / "a.ply"]
    old, new = plyfile.PlyData.read(source), plyfile.PlyData.read(out / "a.ply")
    codes, confidence, objects = make_labels(0, 40)
    np.testing.assert_array_equal(new["vertex"]["classification"], codes)
    np.testing.assert_allclose(new["vertex"]["confidence"], confidence, rtol=1e-7)
    np.testing.assert_array_equal(new["vertex"]["object_id"], objects)
    for name, _ in fields[:-1]:
        np.testing.assert_array_equal(new["vertex"][name], old["vertex"][name])
    np.testing.assert_array_equal(new["vertex"]["original_classification"], table["classification"])
    assert [list(f[0]) for f in new["face"]] == [[0, 1, 2], [1, 2, 3, 4]]
    assert (new.text, new.byte_order, new.comments) == (old.text, old.byte_order, old.comments)
    las = laspy.read(out / "a.laz")
    check_written_labels(las)
    np.testing.assert_array_equal(las.red // 257, table["red"])
    np.testing.assert_array_equal(las["original_classification"], table["classification"])
    assert las.header.parse_crs().to_epsg() == 28992


def test_kitti_gains_a_label_file(tmp_path, rng):
    source, out = tmp_path / "7.bin", tmp_path / "out"
    rng.random((30, 4)).astype("<f4").tofile(source)
    labels = rng.integers(0, 2**32, 30, dtype=np.uint32)
    labels.tofile(tmp_path / "7.label")
    assert write_labelled(source, out / "7.laz", make_labels, chunk_size=7) == [out / "7.laz", out / "7.label"]
    new = np.fromfile(out / "7.label", "<u4")
    np.testing.assert_array_equal(new & 0xFFFF, make_labels(0, 30)[0])
    np.testing.assert_array_equal(new >> 16, labels >> 16)
    las = laspy.read(out / "7.laz")
    check_written_labels(las)
    np.testing.assert_array_equal(las["label"], labels & 0xFFFF)
    np.testing.assert_array_equal(las["instance"], labels >> 16)
    with pytest.raises(DataError, match=r"7\.label holds .*7\.bin"):
        write_labelled(source, tmp_path / "7.laz", make_labels)
    assert write_labelled(source, tmp_path / "7.laz", make_labels, native=False) == [tmp_path / "7.laz"]
    np.testing.assert_array_equal(np.fromfile(tmp_path / "7.label", "<u4"), labels)


def test_options_reach_other_formats(tmp_path):
    source = tmp_path / "a.csv"
    source.write_text("480000000,5455000000,2000,11\n")
    options = ReadOptions(columns={"label": 3}, units="millimetre", crs="EPSG:25832")
    write_labelled(source, tmp_path / "out" / "a.laz", make_labels, options=options)
    las = laspy.read(tmp_path / "out" / "a.laz")
    assert las.xyz.tolist() == [[480000.0, 5455000.0, 2.0]]
    assert las["label"].tolist() == [11]
    assert las.header.parse_crs().to_epsg() == 25832


def test_parquet_keeps_its_columns_and_metadata(tmp_path, rng):
    source, out = tmp_path / "a.parquet", tmp_path / "out"
    columns = {
        **{"x": rng.random(50), "y": rng.random(50), "z": rng.random(50), "classification": rng.integers(0, 9, 50)},
        **{"when": pd.date_range("2024-01-01", periods=50), "who": ["a", "b"] * 25},
    }
    frame = pd.DataFrame(columns, index=pd.Index(np.arange(50) * 2, name="number"))
    table = pa.Table.from_pandas(frame)
    table = table.replace_schema_metadata({**table.schema.metadata, b"crs": pyproj.CRS(28992).to_wkt().encode()})
    pq.write_table(table, source, row_group_size=19)
    assert write_labelled(source, out / "a.laz", make_labels, chunk_size=13) == [out / "a.laz", out / "a.parquet"]
    new = pq.read_table(out / "a.parquet")
    codes, confidence, objects = make_labels(0, 50)
    np.testing.assert_array_equal(new["classification"], codes)
    np.testing.assert_array_equal(new["confidence"], confidence)
    np.testing.assert_array_equal(new["object_id"], objects)
    assert new["original_classification"].equals(table["classification"])
    for name in ("x", "y", "z", "when", "who", "number"):
        assert new[name].equals(table[name]), name
    assert new.schema.metadata == table.schema.metadata
    assert new.to_pandas()["who"].tolist() == columns["who"]
    assert get_format(out / "a.parquet").read(out / "a.parquet", ReadOptions()).crs == pyproj.CRS(28992).to_wkt()
    check_written_labels(laspy.read(out / "a.laz"))
    first = (out / "a.parquet").read_bytes()
    write_labelled(source, out / "a.laz", make_labels, chunk_size=13)
    assert (out / "a.parquet").read_bytes() == first


def test_npz_keeps_its_arrays(tmp_path, rng):
    source, out = tmp_path / "a.npz", tmp_path / "out"
    arrays = {"points": rng.random((40, 3)), "confidence": rng.random(40), "about": np.array("a street")}
    np.savez(source, **arrays)
    assert write_labelled(source, out / "a.laz", make_labels, chunk_size=13) == [out / "a.laz", out / "a.npz"]
    new = np.load(out / "a.npz")
    codes, confidence, objects = make_labels(0, 40)
    assert set(new) == {"points", "about", "original_confidence", "classification", "confidence", "object_id"}
    np.testing.assert_array_equal(new["points"], arrays["points"])
    np.testing.assert_array_equal(new["original_confidence"], arrays["confidence"])
    np.testing.assert_array_equal(new["classification"], codes)
    np.testing.assert_array_equal(new["confidence"], confidence)
    np.testing.assert_array_equal(new["object_id"], objects)
    assert new["classification"].dtype == np.uint8 and str(new["about"]) == "a street"
    np.save(tmp_path / "b.npy", arrays["points"])
    assert write_labelled(tmp_path / "b.npy", out / "b.laz", make_labels) == [out / "b.laz"]


@pytest.mark.parametrize("name", ["a.pcd", "a.pcd.gz"])
def test_pcd_keeps_its_fields(tmp_path, rng, name):
    n = 40
    source, out = tmp_path / name, tmp_path / "out"
    record = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("classification", "<i2"), ("h", "<f4", 2)])
    points = np.zeros(n, record)
    for field in ("x", "y", "z", "h"):
        points[field] = rng.normal(size=points[field].shape)
    points["classification"] = rng.integers(0, 99, n)
    head = (
        "# .PCD v0.7\nVERSION 0.7\nFIELDS x y z classification h\nSIZE 4 4 4 2 4\nTYPE F F F I F\n"
        f"COUNT 1 1 1 1 2\nWIDTH {n}\nHEIGHT 1\nVIEWPOINT 1 2 3 1 0 0 0\nPOINTS {n}\nDATA binary\n"
    )
    data = head.encode() + points.tobytes()
    source.write_bytes(gzip.compress(data) if name.endswith("gz") else data)
    assert write_labelled(source, out / "a.laz", make_labels, chunk_size=13) == [out / "a.laz", out / name]
    form = get_format(out / name)
    new, old = form.read(out / name, ReadOptions()), form.read(source, ReadOptions())
    codes, confidence, objects = make_labels(0, n)
    np.testing.assert_array_equal(new["classification"], codes)
    np.testing.assert_array_equal(new["confidence"], confidence)
    np.testing.assert_array_equal(new["object_id"], objects)
    np.testing.assert_array_equal(new["original_classification"], points["classification"])
    np.testing.assert_array_equal(new.xyz, old.xyz)
    np.testing.assert_array_equal(new["h_1"], points["h"][:, 1])
    assert form.info(out / name, ReadOptions()).details["viewpoint"] == "1 2 3 1 0 0 0"
    if name == "a.pcd":
        seen = open3d.t.io.read_point_cloud(str(out / name))
        np.testing.assert_array_equal(seen.point["classification"].numpy()[:, 0], codes)
        np.testing.assert_array_equal(seen.point["confidence"].numpy()[:, 0], confidence)
        np.testing.assert_array_equal(seen.point["object_id"].numpy()[:, 0], objects)


@pytest.mark.parametrize(("last", "n_points"), [("_", 20), ("w", 19)], ids=["padding", "no return"])
def test_other_pcd_is_written_as_laz_only(tmp_path, rng, last, n_points):
    values = rng.random((20, 4)).astype("<f4")
    values[7, :3] = 0.0 if last == "_" else np.nan
    head = f"# .PCD v0.7\nFIELDS x y z {last}\nSIZE 4 4 4 4\nTYPE F F F F\nWIDTH 20\nHEIGHT 1\nDATA binary\n"
    (tmp_path / "a.pcd").write_bytes(head.encode() + values.tobytes())
    out = tmp_path / "out"
    assert write_labelled(tmp_path / "a.pcd", out / "a.laz", make_labels) == [out / "a.laz"]
    assert len(laspy.read(out / "a.laz").points) == n_points

"""Parquet, NPZ and NPY against pandas and NumPy."""

import io
import zipfile

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from mlsroad_pipeline.algorithms.core.exceptions import DataError, MissingColumnError, ReadError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.formats import parquet
from mlsroad_pipeline.formats.base import ReadOptions, WriteOptions
from mlsroad_pipeline.formats.crs import parse_crs
from mlsroad_pipeline.formats.npz import NpzFormat
from mlsroad_pipeline.formats.parquet import ParquetFormat
from mlsroad_pipeline.formats.registry import get_format

DEFAULT = ReadOptions()
UTM = parse_crs("EPSG:25832")


def make_cloud(rng, n=1000):
    columns = {
        **{"rgb": rng.integers(0, 256, (n, 3), dtype=np.uint8), "intensity": rng.random(n).astype(np.float32)},
        **{"gps_time": rng.random(n) * 1e9, "label": rng.integers(0, 90, n, dtype=np.int16)},
        **{"big": rng.integers(-(2**62), 2**62, n), "flag": rng.random(n) < 0.5},
    }
    columns["intensity"][0] = 1.0
    return PointCloud(rng.random((n, 3)) * 100, columns, np.array([480_000.0, 5_455_000.0, 0.0]), UTM)


@pytest.mark.parametrize(("form", "name"), [(ParquetFormat(), "a.parquet"), (NpzFormat(), "a.npz")])
def test_written_back(tmp_path, rng, monkeypatch, form, name):
    monkeypatch.setattr(parquet, "GROUP", 300)
    cloud = make_cloud(rng)
    path = tmp_path / "deep" / name
    form.write(path, cloud, WriteOptions())
    assert get_format(path).name == form.name
    again = form.read(path, DEFAULT)
    np.testing.assert_array_equal(again.world_xyz(), cloud.world_xyz())
    assert set(again.columns) == set(cloud.columns)
    for column, values in cloud.columns.items():
        np.testing.assert_array_equal(again[column], values)
    assert again["big"].dtype == np.int64
    assert again.crs == UTM
    info = form.info(path, DEFAULT)
    assert info.n_points == 1000
    assert dict(info.columns) == {column: values.dtype for column, values in again.columns.items()}
    for start, stop in [(0, 1), (299, 301), (300, 600), (250, 950), (999, None), (500, 500), (2000, 3000)]:
        part = form.read(path, DEFAULT, start=start, stop=stop)
        np.testing.assert_array_equal(part.world_xyz(), cloud.world_xyz()[start:stop])
        np.testing.assert_array_equal(part["big"], cloud["big"][start:stop])
    first = path.read_bytes()
    form.write(path, cloud, WriteOptions())
    assert path.read_bytes() == first
    form.write(path, cloud.select(np.arange(0)), WriteOptions())
    assert len(form.read(path, DEFAULT)) == 0


def test_tables_of_pandas(tmp_path, caplog):
    frame = pd.DataFrame(
        {
            **{"X": [1.0, 2.0], "Y": [3, 4], "Z": np.float32([5, 6]), "street": ["a", "b"]},
            **{
                "when": pd.to_datetime(["2020-01-01", "2020-01-01 00:00:00.25"], utc=True, format="ISO8601"),
                "seen": [True, False],
            },
            "count": pd.array([7, None], dtype="Int32"),
        }
    )
    path = tmp_path / "a.parquet"
    frame.to_parquet(path)
    with caplog.at_level("INFO"):
        cloud = ParquetFormat().read(path, ReadOptions(columns={"gps_time": "when"}))
    assert "left out: street" in caplog.text
    assert cloud.world_xyz().tolist() == [[1, 3, 5], [2, 4, 6]]
    assert np.diff(cloud["gps_time"]).tolist() == [0.25]
    assert cloud["gps_time"][0] == 1_577_836_800
    assert cloud["seen"].tolist() == [1, 0]
    assert cloud["count"][0] == 7
    assert np.isnan(cloud["count"][1])


def test_lists_of_fixed_length(tmp_path):
    xyz = pa.FixedSizeListArray.from_arrays(pa.array(np.arange(6.0)), 3)
    rgb = pa.FixedSizeListArray.from_arrays(pa.array(np.arange(6, dtype=np.uint8)), 3)
    normal = pa.FixedSizeListArray.from_arrays(pa.array(np.arange(4.0)), 2)
    pq.write_table(pa.table({"xyz": xyz, "rgb": rgb, "n": normal}), tmp_path / "a.parquet")
    cloud = ParquetFormat().read(tmp_path / "a.parquet", DEFAULT)
    assert cloud.xyz.tolist() == [[0, 1, 2], [3, 4, 5]]
    assert cloud["rgb"].tolist() == [[0, 1, 2], [3, 4, 5]]
    assert cloud["n_1"].tolist() == [1, 3]


def test_arrays_of_numpy(tmp_path, rng, caplog):
    points = rng.random((20, 5)).astype(">f4")
    path = tmp_path / "a.npz"
    np.savez(path, points=points, colors=rng.random((20, 3)), classes=np.arange(20), faces=np.zeros((7, 3)), note="x")
    with caplog.at_level("INFO"):
        cloud = get_format(path).read(path, ReadOptions(columns={"label": "classes", "intensity": "column_3"}))
    assert "left out: faces, note" in caplog.text
    np.testing.assert_array_equal(cloud.xyz, points[:, :3].astype(np.float64))
    np.testing.assert_array_equal(cloud["intensity"], points[:, 3])
    np.testing.assert_array_equal(cloud["column_4"], points[:, 4])
    assert cloud["label"].tolist() == list(range(20))
    assert cloud["rgb"].dtype == np.uint8
    table = np.zeros(4, dtype=[("x", "f8"), ("y", "f4"), ("z", "f4"), ("class", "u1"), ("normal", "f4", 3)])
    table["x"], table["class"], table["normal"] = np.arange(4), 3, [1, 2, 3]
    for name in ("b.npy", "c"):
        with (tmp_path / name).open("wb") as stream:
            np.save(stream, table)
        cloud = get_format(tmp_path / name).read(tmp_path / name, DEFAULT, start=1)
        assert cloud.xyz[:, 0].tolist() == [1, 2, 3]
        assert cloud["normal_2"].tolist() == [3, 3, 3]
    np.save(tmp_path / "d.npy", np.asfortranarray(points))
    np.testing.assert_array_equal(NpzFormat().read(tmp_path / "d.npy", DEFAULT).xyz, points[:, :3].astype(np.float64))


def test_an_array_of_dates_is_the_time_and_one_of_the_seconds_of_a_turn_is_not(tmp_path, rng):
    xyz, dates = rng.random((20, 3)), 1_557_539_924.5 + np.arange(20.0)
    read = NpzFormat().read
    for name, times in {"dates": dates, "turn": np.linspace(0, 0.1, 20), "unknown": np.full(20, np.nan)}.items():
        np.savez(tmp_path / f"{name}.npz", xyz=xyz, time=times, sweep=np.arange(20))
        cloud = read(tmp_path / f"{name}.npz", DEFAULT)
        own = "gps_time" if name == "dates" else "time"
        assert set(cloud.columns) == {own, "sweep"}
        np.testing.assert_array_equal(cloud[own], times)
    path = tmp_path / "dates.npz"
    assert set(read(path, ReadOptions(columns={"label": "sweep"})).columns) == {"gps_time", "label"}
    assert set(read(path, ReadOptions(only=("gps_time",))).columns) == {"gps_time"}
    assert set(read(path, ReadOptions(columns={"when": "time"})).columns) == {"when", "sweep"}
    assert dict(NpzFormat().info(path, DEFAULT).columns)["gps_time"] == np.float64
    np.savez(path, xyz=xyz, time=dates, timestamp=dates + 1)
    np.testing.assert_array_equal(read(path, DEFAULT)["gps_time"], dates + 1)


def zipped(entries):
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in entries.items():
            archive.writestr(name, content)
    return packed.getvalue()


def npy(shape, data=b"", descr="<f8"):
    head = f"{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}".ljust(117) + "\n"
    return b"\x93NUMPY\x01\x00" + len(head).to_bytes(2, "little") + head.encode() + data


@pytest.mark.parametrize(
    ("name", "content", "error", "message"),
    [
        ("a.npz", zipped({"xyz.npy": npy((10**12, 3))}), ReadError, r"xyz\.npy claims \(1000000000000, 3\) values"),
        ("a.npz", zipped({"xyz.npy": npy((3, 3), bytes(71))}), ReadError, r"claims \(3, 3\) values of float64 in 71"),
        ("a.npz", zipped({"xyz.npy": npy((1, 3), b"", "|O")}), ReadError, r"holds Python objects"),
        ("a.npz", zipped({"xyz.npy": npy((9, 3), bytes(216))})[:150], ReadError, r"a\.npz is damaged"),
        ("a.npz", zipped({"faces.npy": npy((1, 3), bytes(24))}), MissingColumnError, r"no column 'x'"),
        ("a.npz", zipped({"doc.xml": b"<a/>"}), ReadError, r"named as NPZ, but holds ZIP"),
        ("a.npy", npy((2, 3), bytes(40)), ReadError, r"a\.npy claims"),
        ("a.parquet", b"PAR1" + bytes(100), ReadError, r"a\.parquet is damaged"),
        ("a.parquet", b"PAR1", ReadError, r"a\.parquet is damaged"),
    ],
)
def test_damage_is_named(tmp_path, name, content, error, message):
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(error, match=message):
        get_format(path).read(path, DEFAULT)


def test_what_npz_cannot_hold(tmp_path, rng):
    with pytest.raises(DataError, match="clouds are written as .npz"):
        NpzFormat().write(tmp_path / "a.npy", make_cloud(rng, 3), WriteOptions())
    with pytest.raises(DataError, match="'crs' has a name"):
        NpzFormat().write(tmp_path / "a.npz", make_cloud(rng, 3).with_columns(crs=np.zeros(3)), WriteOptions())


def test_of_a_thousand_arrays_the_first_are_named(tmp_path):
    arrays = {name: np.zeros(3) for name in ("x", "y", *(f"ground_{k}" for k in range(998)))}
    np.savez(tmp_path / "polygons.npz", **arrays)
    with pytest.raises(MissingColumnError, match=r"ground_17 and 980 more\)"):
        NpzFormat().read(tmp_path / "polygons.npz", DEFAULT)

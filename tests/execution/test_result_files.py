"""Files of results: bit-exact round trips, and equal bytes for equal results."""

import io

import numpy as np
import pandas as pd
import pytest
from helpers.store import make_cloud
from scipy import sparse

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.execution.result_files import ARRAYS, POINTS, SINGLE, TABLE, read_part, split_parts, write_part

DTYPES = ["?", "i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8", "f2", "f4", "f8", ">f4", ">i4"]


def to_bytes(kind, value):
    stream = io.BytesIO()
    write_part(kind, value, stream)
    return stream.getvalue()


def there_and_back(value):
    ((name, (kind, part)),) = split_parts(value).items()
    assert name == SINGLE
    data = to_bytes(kind, part)
    assert to_bytes(kind, part) == data
    return read_part(kind, io.BytesIO(data))


def assert_same_bits(got, expected):
    assert got.dtype == expected.dtype
    assert got.shape == expected.shape
    assert got.tobytes() == expected.tobytes()
    assert got.flags.writeable


def assert_same_cloud(got, expected):
    assert_same_bits(got.xyz, expected.xyz)
    assert list(got.columns) == list(expected.columns)
    for name in expected.columns:
        assert_same_bits(got[name], np.ascontiguousarray(expected[name]))
    assert_same_bits(got.origin, expected.origin)
    assert (got.crs, got.source) == (expected.crs, expected.source)


@pytest.mark.parametrize("n", [0, 1, 1000])
def test_point_cloud_comes_back_bit_for_bit(n):
    cloud = make_cloud(n)
    assert_same_cloud(there_and_back(cloud), cloud)


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("shape", [(5,), (5, 3), (5, 2, 2), (5, 0)])
def test_column_keeps_dtype_and_shape(dtype, shape, rng):
    column = (rng.normal(size=shape) * 50).astype(dtype)
    cloud = PointCloud(np.zeros((5, 3), np.float32), {"c": column})
    got = there_and_back(cloud)
    assert_same_bits(got["c"], column)
    assert got.xyz.dtype == np.float32
    assert got.crs is None


def test_nan_infinity_and_negative_zero_survive():
    special = np.array([np.nan, -np.nan, np.inf, -np.inf, -0.0, 5e-324])
    cloud = PointCloud(np.column_stack([special] * 3), {"single": special.astype(np.float32), "double": special})
    assert_same_cloud(there_and_back(cloud), cloud)
    got = there_and_back({"a": special})
    assert_same_bits(got["a"], special)


def test_columns_of_clashing_names_are_kept_apart(rng):
    columns = {"x": rng.random(4), "rgb": rng.random((4, 2)), "rgb[1]": rng.random(4), "": rng.random(4)}
    cloud = PointCloud(rng.random((4, 3)), columns)
    assert_same_cloud(there_and_back(cloud), cloud)


def test_strided_columns_are_stored_and_left_alone(rng):
    base = rng.random((10, 6))
    cloud = PointCloud(base[::2, :3], {"c": base[::2, 4]})
    before = base.copy()
    assert_same_cloud(there_and_back(cloud), PointCloud(base[::2, :3].copy(), {"c": base[::2, 4].copy()}))
    assert np.array_equal(base, before)


@pytest.mark.parametrize("column", [np.array(["a", "b"]), np.array([1j, 2]), np.array([None, 1]), np.zeros(2, "g")])
def test_column_that_parquet_cannot_hold_is_refused(column):
    cloud = PointCloud(np.zeros((2, 3)), {"odd": column}, source="file.ply")
    with pytest.raises(DataError, match=r"file\.ply: column 'odd' of dtype .* cannot be stored"):
        to_bytes(POINTS, cloud)


def test_arrays_come_back_in_order(rng):
    arrays = {
        "b": rng.random((3, 4)),
        "a": np.asfortranarray(rng.integers(0, 9, (3, 2))),
        "file": np.zeros((0, 7), np.float32),
        "scalar": np.array(3, dtype=np.int8),
        "names": np.array(["road", "tree"]),
        "record": np.array([(1, 2.0)], dtype=[("i", "u1"), ("f", "f8")]),
    }
    got = there_and_back(arrays)
    assert list(got) == list(arrays)
    for name, array in arrays.items():
        assert_same_bits(got[name], array)


def test_sparse_matrix_comes_back_with_its_indices(rng):
    dense = rng.random((5, 7)) * (rng.random((5, 7)) > 0.6)
    matrix = sparse.csr_array(dense.astype(np.float32))
    matrix.indices = matrix.indices.astype(np.int32)
    got = there_and_back({"before": np.zeros(1), "graph": matrix, "empty": sparse.csr_array((0, 3))})
    assert list(got) == ["before", "graph", "empty"]
    assert isinstance(got["graph"], sparse.csr_array)
    for field in ("data", "indices", "indptr"):
        assert_same_bits(getattr(got["graph"], field), getattr(matrix, field))
    assert got["graph"].shape == (5, 7)
    assert got["empty"].shape == (0, 3)


def test_files_open_without_this_package(rng, tmp_path):
    (tmp_path / "p.parquet").write_bytes(to_bytes(POINTS, make_cloud(5)))
    frame = pd.read_parquet(tmp_path / "p.parquet")
    assert {"x", "y", "z", "rgb[0]", "intensity"} <= set(frame.columns)
    matrix = sparse.csr_array(np.eye(2))
    (tmp_path / "a.npz").write_bytes(to_bytes(ARRAYS, {"graph": matrix}))
    with np.load(tmp_path / "a.npz") as archive:
        fields = {name: archive[f"graph/{name}"] for name in ("data", "indices", "indptr")}
        rebuilt = sparse.csr_array(tuple(fields.values()), shape=tuple(archive["graph/shape"]))
    assert (rebuilt != matrix).nnz == 0


@pytest.mark.parametrize(
    "frame",
    [
        pd.DataFrame({"name": ["pole", None], "height": [1.5, np.nan], "n": [1, 2]}, index=["a", "b"]),
        pd.DataFrame({"kind": pd.Categorical(["x", "y"]), "when": pd.to_datetime(["2020-01-01", "2021-06-01"])}),
        pd.DataFrame({"n": np.array([], dtype=np.int16)}),
        pd.DataFrame(index=pd.MultiIndex.from_product([["s"], [1, 2]], names=["split", "fold"]), data={"v": [1, 2]}),
    ],
)
def test_table_comes_back(frame):
    pd.testing.assert_frame_equal(there_and_back(frame), frame)


def test_table_of_objects_is_refused():
    with pytest.raises(DataError, match="a table cannot be stored"):
        to_bytes(TABLE, pd.DataFrame({"o": [object()]}))


@pytest.mark.parametrize(
    ("result", "message"),
    [
        (3, "a scene's result must be a PointCloud, a DataFrame or a mapping, got int"),
        (None, "got NoneType"),
        ({"a": np.zeros(1), "b": "text"}, "part 'a' of a result cannot be stored: it is a ndarray"),
        ({"p": {"inner": [1]}}, "part 'p' of a result cannot be stored: it is a mapping with 'inner': list"),
        ({"a/b": make_cloud(1)}, "cannot be called 'a/b'"),
        ({"..": make_cloud(1)}, r"cannot be called '\.\.'"),
        ({"result": make_cloud(1)}, "cannot be called 'result'"),
    ],
)
def test_result_that_cannot_be_stored_is_named(result, message):
    with pytest.raises(DataError, match=message):
        split_parts(result)


@pytest.mark.parametrize(
    ("arrays", "message"),
    [({"o": np.array([None])}, "array 'o' of dtype object"), ({"a/b": np.zeros(1)}, "cannot be called 'a/b'")],
)
def test_array_that_npz_cannot_hold_is_refused(arrays, message):
    with pytest.raises(DataError, match=message):
        to_bytes(ARRAYS, arrays)

"""KITTI scans with and without labels."""

import numpy as np
import pytest

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ReadError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.formats.base import ReadOptions, WriteOptions
from mlsroad_pipeline.formats.kitti import KittiFormat

KITTI = KittiFormat()
DEFAULT = ReadOptions()


def make_scan(folder, rng, n=100, label_folder=None):
    folder.mkdir(exist_ok=True, parents=True)
    points = rng.random((n, 4)).astype("<f4")
    points.tofile(folder / "000007.bin")
    labels = rng.integers(0, 2**32, n, dtype=np.uint32)
    if label_folder is not None:
        label_folder.mkdir(exist_ok=True)
        labels.astype("<u4").tofile(label_folder / "000007.label")
    return folder / "000007.bin", points, labels


@pytest.mark.parametrize("beside", [True, False])
def test_points_labels_and_ranges(tmp_path, rng, beside):
    folder = tmp_path / "velodyne"
    path, points, labels = make_scan(folder, rng, label_folder=folder if beside else tmp_path / "labels")
    cloud = KITTI.read(path, DEFAULT)
    np.testing.assert_array_equal(cloud.xyz, points[:, :3].astype(np.float64))
    np.testing.assert_array_equal(cloud["intensity"], points[:, 3])
    np.testing.assert_array_equal(cloud["label"], labels % 65536)
    np.testing.assert_array_equal(cloud["instance"], labels // 65536)
    np.testing.assert_array_equal(cloud.origin, 0)
    info = KITTI.info(path, DEFAULT)
    assert info.n_points == 100
    assert dict(info.columns) == {name: values.dtype for name, values in cloud.columns.items()}
    part = KITTI.read(path, DEFAULT, start=40, stop=44)
    np.testing.assert_array_equal(part["label"], cloud["label"][40:44])
    assert type(part.xyz) is np.ndarray


def test_without_labels_and_written_back(tmp_path, rng):
    path, _, labels = make_scan(tmp_path / "a", rng)
    cloud = KITTI.read(path, DEFAULT)
    assert set(cloud.columns) == {"intensity"}
    with_labels = cloud.with_columns(label=labels % 65536, instance=labels >> 16)
    KITTI.write(tmp_path / "b" / "000007.bin", with_labels, WriteOptions())
    assert (tmp_path / "b" / "000007.bin").read_bytes() == path.read_bytes()
    np.testing.assert_array_equal(np.fromfile(tmp_path / "b" / "000007.label", "<u4"), labels)


def test_unfit_files_and_clouds(tmp_path, rng):
    path, _, _ = make_scan(tmp_path, rng, label_folder=tmp_path)
    (tmp_path / "odd.bin").write_bytes(bytes(33))
    with pytest.raises(ReadError, match=r"odd\.bin has 33 bytes.* 16 "):
        KITTI.read(tmp_path / "odd.bin", DEFAULT)
    (tmp_path / "000007.label").write_bytes(bytes(4 * 99))
    with pytest.raises(ReadError, match=r"07\.label has 99 .* 100 .*07\.bin"):
        KITTI.info(path, DEFAULT)
    nan = np.ones((20, 4), "<f4")
    nan[12:14, 1] = np.nan
    nan.tofile(tmp_path / "nan.bin")
    with pytest.raises(DataError, match=r"nan\.bin: 2 .* row 12: \[1\.0, nan"):
        KITTI.read(tmp_path / "nan.bin", DEFAULT, start=5)
    cloud = PointCloud(np.zeros((3, 3)), {"rgb": np.zeros((3, 3), np.uint8)})
    with pytest.raises(DataError, match=r"KITTI scans cannot hold rgb"):
        KITTI.write(tmp_path / "x.bin", cloud, WriteOptions())
    with pytest.raises(DataError, match="label 0 to 65536 .* 16 bits"):
        KITTI.write(tmp_path / "x.bin", PointCloud(np.zeros((2, 3)), {"label": np.array([0, 65536])}), WriteOptions())


@pytest.mark.real_data
def test_semantickitti_scan(real_data):
    cloud = KITTI.read(real_data("semantickitti", "000000.bin"), DEFAULT)
    assert len(cloud) == 123_389
    assert {0, 10, 40, 50, 70, 80, 81} <= set(np.unique(cloud["label"]).tolist())

"""E57 scans with poses that old programs write."""

import numpy as np
import pytest

from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.formats.base import ReadOptions, WriteOptions
from mlsroad_pipeline.formats.e57.format import E57Format
from mlsroad_pipeline.formats.e57.pages import CONTENT, HEADER, PAGE, pack_pages

XYZ = np.arange(15.0).reshape(5, 3)


def with_pose(path, rotation, translation=(10, 20, 30)):
    """Write a scan and insert a pose into its XML."""
    E57Format().write(path, PointCloud(XYZ, {}, np.zeros(3), None, str(path)), WriteOptions())
    pages = np.frombuffer(path.read_bytes(), np.uint8).reshape(-1, PAGE)
    content = pages[:, :CONTENT].tobytes()
    _, _, _, _, xml_at, size, _ = head = HEADER.unpack(content[: HEADER.size])
    begin = xml_at // PAGE * CONTENT + xml_at % PAGE
    inside = "".join(f'<{k} type="Float">{v}</{k}>' for k, v in zip("wxyz", rotation, strict=True))
    moved = "".join(f'<{k} type="Float">{v}</{k}>' for k, v in zip("xyz", translation, strict=True))
    pose = (
        f'<pose type="Structure"><rotation type="Structure">{inside}</rotation>'
        f'<translation type="Structure">{moved}</translation></pose>'
    )
    name = b'<name type="String">points</name>'
    xml = content[begin : begin + size].replace(name, name + pose.encode())
    body = content[HEADER.size : begin] + xml
    n_pages = -(-(HEADER.size + len(body)) // CONTENT)
    start = HEADER.pack(*head[:3], n_pages * PAGE, xml_at, len(xml), PAGE)
    path.write_bytes(pack_pages(start + body).tobytes())


@pytest.mark.parametrize(
    "rotation", [(0, 0, 0, 0), (0.0, -0.0, 0, 0), (1e-12, 0, 0, 0), (1, 0, 0, 0), (5, 0, 0, 0), (1e-3, 0, 0, 0)]
)
def test_a_rotation_without_a_direction_is_none(tmp_path, rotation):
    path = tmp_path / "a.e57"
    with_pose(path, rotation)
    np.testing.assert_allclose(E57Format().read(path, ReadOptions()).world_xyz(), XYZ + [10, 20, 30])
    notes = E57Format().info(path, ReadOptions()).notes
    assert bool(notes) == (np.linalg.norm(rotation) < 1e-9)
    if notes:
        assert notes == ("scan 0 has a rotation without a direction (a zero quaternion): it is not rotated",)

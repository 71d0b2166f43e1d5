"""Files of a folder that hold no points are left out with their reason; whatever may hold points is not."""

import laspy
import numpy as np
import pytest

from mlsroad_pipeline.algorithms.core.exceptions import ReadError
from mlsroad_pipeline.algorithms.scenes.parameters import IngestParameters
from mlsroad_pipeline.surveys.discovery import no_points_reason
from mlsroad_pipeline.surveys.files import Survey
from mlsroad_pipeline.surveys.parameters import LabelParameters
from mlsroad_pipeline.surveys.plan import plan_labelling


def las(path, n=5):
    made = laspy.LasData(laspy.LasHeader(version="1.4", point_format=6))
    made.x = made.y = made.z = np.arange(n, dtype=float)
    made.write(path)
    return path


@pytest.mark.parametrize(
    ("name", "content", "reason"),
    [
        ("a.las", b"", "is empty (0 bytes)"),
        ("a.bin", b"", "is empty (0 bytes)"),
        ("a.las", b"<html>not found</html>", "is HTML or XML, not LAS"),
        ("a.e57", b"%PDF-1.4", "is PDF, not E57"),
        ("a.ply", b"solid cube", None),  # unknown: an error when it is read
        ("a.pcd", b"# This PCD file has another first line", None),
        ("labels.txt", b"1 car\n2 tree\n", "holds no row of three numbers"),
        ("readme.txt", b"Survey of 2024, two passes, north to south.\n", "holds no row of three numbers"),
        ("a.txt", b"1 2 3\n4 5 6\nDear Sir or Madam\n", None),  # a damaged table
        ("a.csv", b"x;y;z\n1,5;2,5;3,5\n", None),
        ("a.laz", b"LASF and no more", None),  # truncated
        ("a.laz", b"PK\x03\x04 packed", None),  # may hold points
    ],
)
def test_reason(tmp_path, name, content, reason):
    path = tmp_path / name
    path.write_bytes(content)
    assert no_points_reason(path) == reason


def test_clouds_are_kept_and_empty_ones_are_not(tmp_path):
    assert no_points_reason(las(tmp_path / "a.las")) is None
    assert no_points_reason(las(tmp_path / "b.las", n=0)) == "is a LAS file without points"


def test_a_delimiter_of_the_options_keeps_text_that_is_not_recognised(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text("1|2|3\n4|5|6\n")
    assert no_points_reason(path) and no_points_reason(path, text=False) is None


def planned(tmp_path, survey):
    return plan_labelling(LabelParameters(str(survey), str(tmp_path / "out")), IngestParameters())


@pytest.mark.parametrize("place", ["in", "in/*"])
def test_plan_has_the_clouds_and_the_reasons_of_the_others(tmp_path, place):
    folder = tmp_path / "in"
    (folder / "b").mkdir(parents=True)
    las(folder / "a.las")
    (folder / "b" / "empty.las").write_bytes(b"")
    (folder / "b" / "labels.txt").write_text("1 car\n")
    plan = planned(tmp_path, tmp_path / place)
    assert [file.source.name for file in plan.files] == ["a.las"]
    assert plan.skipped["b/empty.las"] == "is empty (0 bytes): skipped"
    assert set(plan.skipped) == {"b/empty.las", "b/labels.txt"} and plan.skipped["b/labels.txt"].endswith(": skipped")


def test_a_survey_without_any_points_is_an_error_with_the_reasons(tmp_path):
    (tmp_path / "in").mkdir()
    for name in ("a.las", "b.laz"):
        (tmp_path / "in" / name).write_bytes(b"")
    with pytest.raises(ReadError, match=r"in holds no point cloud: a.las is empty \(0 bytes\); b.laz is empty"):
        planned(tmp_path, tmp_path / "in")


def test_a_file_that_is_named_is_not_skipped(tmp_path):
    las(tmp_path / "a.las")
    (tmp_path / "b.las").write_bytes(b"")
    listing = Survey.at([str(tmp_path / "b.las"), str(tmp_path / "*.las")]).listing()
    assert [file.name for file in listing.files] == ["a.las", "b.las"] and not listing.skipped

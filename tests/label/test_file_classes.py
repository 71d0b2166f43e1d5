"""Classes in the files of a survey to be labelled: detection on reading, and the copy in the result."""

import laspy
import numpy as np
import pytest
from helpers.formats import make_labels, make_las

from mlsroad_pipeline.algorithms.scenes.corridor import corridor_to_arrays
from mlsroad_pipeline.algorithms.scenes.splits import SplitPart
from mlsroad_pipeline.formats.base import ReadOptions
from mlsroad_pipeline.label.writer import write_labelled
from mlsroad_pipeline.surveys.reading import read_and_cut


def cut(path, start=0, stop=300, **changes):
    given = {"options": ReadOptions(), "labels": False, "along": False, "part": SplitPart(), "file": 0, **changes}
    return read_and_cut(
        str(path), corridor_to_arrays(None), start=start, stop=stop, n_total=300, bin_length=1.0, time_gap=1.0, **given
    )


@pytest.mark.parametrize(("extension", "point_format"), [("las", 3), ("laz", 1), ("laz", 7)])
def test_a_range_tells_whether_it_has_classes_and_keeps_none(tmp_path, rng, extension, point_format):
    path = tmp_path / f"a.{extension}"
    las = make_las(path, rng, point_format=point_format, extras=False)
    las.classification[:] = 0
    las.classification[-1] = 1
    las.write(str(path))
    first, last = cut(path, 0, 200), cut(path, 200, 300)
    assert first["classes"]["has_classes"].tolist() == [False]
    assert last["classes"]["has_classes"].tolist() == [True]
    assert "column.classification" not in last["points"]
    assert "classification" not in last["quality"]["columns"]


def test_other_formats_and_comparisons_do_not_tell(tmp_path, rng):
    (tmp_path / "a.xyz").write_text("".join(f"{x:.3f} {y:.3f} 0\n" for x, y in rng.random((300, 2))))
    options = ReadOptions(columns={"x": 0, "y": 1, "z": 2}, header=False)
    assert cut(tmp_path / "a.xyz", options=options)["classes"]["has_classes"].shape == (0,)
    make_las(tmp_path / "a.las", rng, point_format=1, extras=False)
    assert cut(tmp_path / "a.las", labels=True)["classes"]["has_classes"].shape == (0,)


@pytest.mark.parametrize("highest", [0, 5])
def test_knowing_the_classes_gives_the_file_that_looking_for_them_gives(tmp_path, rng, highest):
    path = tmp_path / "a.laz"
    las = make_las(path, rng, point_format=6, extras=False)
    las.classification[:] = rng.integers(0, highest + 1, 300)
    las.write(str(path))
    write_labelled(path, tmp_path / "looked.laz", make_labels)
    write_labelled(path, tmp_path / "known.laz", make_labels, had_classes=highest > 0)
    assert (tmp_path / "known.laz").read_bytes() == (tmp_path / "looked.laz").read_bytes()
    kept = "original_classification" in laspy.read(tmp_path / "known.laz").point_format.dimension_names
    assert kept == (highest > 0)
    assert np.asarray(las.classification).max() == highest

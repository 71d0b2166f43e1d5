"""Folds of object files: the Sydney dataset, and malformed lists."""

import numpy as np
import pytest

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.core.exceptions import ReadError, UnknownClassError
from mlsroad_pipeline.papers.shared.recognition.object_set import ObjectSet, find_folds, listed_files, read_fold

NAMES = [
    "4wd",
    "building",
    "bus",
    "car",
    "pedestrian",
    "pillar",
    "pole",
    "traffic_lights",
    "traffic_sign",
    "tree",
    "truck",
    "trunk",
    "ute",
    "van",
]
SCHEME = ClassScheme("sydney14", tuple(NAMES), ((),) * 14, (), (1,) * 14)


def test_folds_of_sydney(real_data):
    folds = find_folds(real_data("sydney"), "folds/fold*.txt")
    assert list(folds)[:3] == ["fold0", "fold1", "fold2"]
    files = listed_files(folds["fold2"])
    found = ObjectSet.from_arrays(read_fold(str(folds["fold2"]), [str(f) for f in files], scheme=SCHEME))
    assert len(found) == 132 and found.label.tolist().count(NAMES.index("pedestrian")) == 34
    assert np.diff(found.indptr).min() >= 13 and np.ptp(found.objects[0], axis=0).max() < 60
    assert 0 <= found.intensity.min() <= found.intensity.max() <= 1


def test_lists_that_are_wrong_are_named(tmp_path, real_data):
    (tmp_path / "folds").mkdir()
    with pytest.raises(ReadError, match=r"has 0 files folds/\*.txt: at least two folds are needed"):
        find_folds(tmp_path, "folds/*.txt")
    wrong = tmp_path / "folds/fold0.txt"
    wrong.write_text("car.0.1.bin\n", encoding="utf-8")
    with pytest.raises(ReadError, match=r"fold0.txt lists car.0.1.bin, which is not in"):
        listed_files(wrong)
    wrong.write_text("\n", encoding="utf-8")
    with pytest.raises(ReadError, match="lists no files"):
        listed_files(wrong)
    strange = tmp_path / "ufo.0.1.bin"
    strange.write_bytes(next(real_data("sydney", "objects").glob("car.*.bin")).read_bytes())
    with pytest.raises(UnknownClassError, match="'sydney14' has no class 'ufo'"):
        read_fold(str(wrong), [str(strange)], scheme=SCHEME)

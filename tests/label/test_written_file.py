"""Labels of a file from those of its scenes: numbers, classes and confidences of the objects, and the counts."""

from dataclasses import dataclass

import numpy as np

from mlsroad_pipeline.label import written_file
from mlsroad_pipeline.label.written_file import SceneLabels

CODES = np.array([11, 64, 66], np.uint8)  # three classes, then unclassified and noise


@dataclass
class Stored:
    key: str
    labels: dict

    def load(self):
        return self.labels


def scene(key, row, label, part, *, file=0):
    n = len(row)
    columns = {"row": np.array(row, np.int64), "label": np.array(label, np.uint8), "part": np.array(part, np.int32)}
    return Stored(key, {"file": np.full(n, file, np.int16), "confidence": np.full(n, 0.9, np.float32), **columns})


def labels_of(*scenes):
    rows = np.array([[item.labels["row"][0], item.labels["row"][-1]] for item in scenes])
    # scene a: two objects wholly in it, of which the rules discard the second, and two voxels of one across the border
    numbers = {"a": np.array([0, 1, 0, 2, 2], np.uint32), "b": np.array([0, 2, 2], np.uint32)}
    classes = {"label": np.array([0, 1, 2], np.uint8), "score": np.array([0.0, 0.75, 0.5], np.float32)}
    return SceneLabels(list(scenes), rows, 0, "a.laz", codes=CODES, numbers=numbers, classes=classes)


def test_points_have_the_number_and_the_class_of_their_object(monkeypatch):
    monkeypatch.setattr(written_file, "SCENES_IN_MEMORY", 1)
    first = scene("a", [0, 2, 3, 5, 6, 7], [0, 1, 0, 1, 2, 1], [0, 1, 1, 2, -1, -2])
    second = scene("b", [1, 4, 8, 9], [3, 2, 4, 3], [0, -2, -1, 0])
    labels = labels_of(first, second)
    parts = [labels(0, 4), labels(4, 10)]
    codes, confidence, number = (np.concatenate(column) for column in zip(*parts, strict=True))
    assert number.tolist() == [0, 0, 1, 1, 2, 0, 2, 2, 2, 0]
    assert codes.tolist() == [11, 1, 64, 64, 66, 64, 66, 66, 66, 1]
    # rows 3, 7 and 8 had another class: they have the scores of their objects
    np.testing.assert_allclose(confidence, [0.9, 0.9, 0.9, 0.75, 0.9, 0.9, 0.9, 0.5, 0.5, 0.9])
    assert (codes.dtype, confidence.dtype, number.dtype) == (np.uint8, np.float32, np.uint32)
    assert labels.counts["counts"].tolist() == [1, 3, 4, 2]
    assert [row.nonzero()[0].tolist() for row in labels.counts["confidences"]] == [[90], [75, 90], [50, 90]]
    assert labels.counts["confidences"].sum(axis=1).tolist() == [1, 3, 4]
    assert first.labels["label"].tolist() == [0, 1, 0, 1, 2, 1]  # the input is unchanged


def test_rows_without_a_label_have_no_confidence_and_are_not_counted():
    labels = labels_of(scene("a", [0, 1, 2], [0, 0, 0], [0, 0, 0]))
    assert np.isnan(labels(0, 4).confidence).tolist() == [False, False, False, True]
    assert labels.counts["counts"].tolist() == [3, 0, 0, 0]

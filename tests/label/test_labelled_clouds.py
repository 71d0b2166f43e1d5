"""Meaning of the class codes of a labelled survey for a register, and positions of the scanner."""

from pathlib import Path

import numpy as np
import pytest
from helpers.labelled import scheme as configured_scheme

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.inventory.objects.rules import KINDS
from mlsroad_pipeline.algorithms.inventory.register.seen_space import FURNITURE, LOW_VEGETATION, NO_KIND
from mlsroad_pipeline.algorithms.scenes.trajectory import Trajectory
from mlsroad_pipeline.label.labelled_clouds import _of_folder, meaning_of_codes, scanner_positions
from mlsroad_pipeline.review.corrections.labelled_output import LabelledOutput

SCHEME = ClassScheme.from_config("road_inventory", configured_scheme())


def output(**label):
    classes = {"schemes": {"road_inventory": configured_scheme()}, "codings": {}}
    return LabelledOutput(Path("out"), {"settings": {"label": label, "classes": classes}})


def test_codes_have_the_kinds_of_their_classes():
    is_ground, kind, label = meaning_of_codes(output(), SCHEME)
    assert np.flatnonzero(is_ground).tolist() == [2, 11]
    assert [SCHEME.classes[n] for n in label[[11, 6, 65]]] == ["paved ground", "building", "sign"] and label[20] == -1
    expected = {
        64: KINDS.index("pole"),
        65: KINDS.index("sign"),
        5: KINDS.index("tree"),
        67: FURNITURE,
        3: LOW_VEGETATION,
    }
    assert {code: int(kind[code]) for code in expected} == expected
    assert (kind[[0, 1, 2, 6, 11, 66, 68]] == NO_KIND).all()


def test_kept_codes_have_the_kinds_of_the_class_map(tmp_path):
    given = {"keep_classes": True}
    is_ground, kind, label = meaning_of_codes(output(scheme="road_inventory", given=given), SCHEME)
    assert is_ground[[2, 8, 11, 64, 65]].all() and not is_ground[[5, 6, 66]].any()
    assert kind[15] == kind[70] == KINDS.index("pole")  # kept tower, written pole
    (tmp_path / "own.yml").write_text("2: other_ground\n20: traffic_sign\n")
    is_ground, kind, label = meaning_of_codes(output(given={**given, "classes": str(tmp_path / "own.yml")}), SCHEME)
    assert kind[20] == KINDS.index("sign") and SCHEME.classes[label[20]] == "sign" and is_ground[2] and is_ground[11]


def test_the_scanner_is_where_the_path_is_at_the_time_of_a_point():
    path = Trajectory.from_positions([[0.0, 0, 2], [10, 0, 2], [20, 0, 4]], [100.0, 101, 102])
    points = np.array([[5.0, 3, 0], [14, -2, 1]])
    assert scanner_positions(path, points, np.array([100.5, 101.75])).tolist() == [[5, 0, 2], [17.5, 0, 3.5]]
    nearest = [[0, 0, 2], [10, 0, 2]]
    assert scanner_positions(path, points - [1, 0, 0], None).tolist() == nearest
    assert scanner_positions(path, points - [1, 0, 0], np.array([5.0, 6.0])).tolist() == nearest  # other times


@pytest.mark.parametrize(("folder", "found"), [(("a",), "one"), (("b", "c"), "two"), ((), None), (("d",), None)])
def test_a_cloud_has_the_trajectory_of_its_folder(folder, found):
    paths = {Path("/s/a/trajectory.csv"): "one", Path("/s/b/c/trajectory.csv"): "two"}
    if folder:
        assert _of_folder(folder, paths) == found
    assert _of_folder(("d",), {Path("/s/trajectory.csv"): "only"}) == "only"

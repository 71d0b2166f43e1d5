import numpy as np
import pytest
from conftest import REPOSITORY
from helpers.yaml_files import read_yaml

from mlsroad_pipeline.algorithms.cameras.legend import Legend
from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError, UnknownClassError


@pytest.fixture(scope="module")
def schemes():
    given = read_yaml(REPOSITORY / "conf" / "base" / "parameters_classes.yml")["classes"]["schemes"]
    return {name: ClassScheme.from_config(name, given[name]) for name in ("tomic2019", "road_inventory")}


LEGEND = Legend.of_rows([(2, "sky", None), (0, "road", "road"), (1, "wall", "wall"), (255, "void", None)], "map.csv")


def test_classes_are_found_in_the_scheme_or_the_taxonomy(schemes):
    assert LEGEND.numbers == (0, 1, 2, 255) and LEGEND.n_scores == 3
    assert LEGEND.labels(schemes["tomic2019"]).tolist() == [0, 4, -1, -1]  # man-made terrain, hard scape
    assert LEGEND.labels(schemes["road_inventory"]).tolist() == [0, 5, -1, -1]  # paved ground, wall or fence
    own = Legend.of_scheme(schemes["tomic2019"])
    assert own.labels(schemes["tomic2019"]).tolist() == [*range(10), -1] and own.n_scores == 11
    assert Legend.from_json(own.to_json()) == own


def test_numbers_become_certain_classes_and_void_becomes_none(schemes):
    found = LEGEND.of_numbers(np.array([[0, 1], [255, 2]]), schemes["tomic2019"], source="a.png")
    assert found.dtype == np.float32 and found.shape == (2, 2, 10)
    assert found[0, 0].tolist() == [1, *[0] * 9] and found[0, 1, 4] == 1 and found[0, 1].sum() == 1
    assert np.isnan(found[1]).all()
    with pytest.raises(DataError, match=r"a\.png: class number 7 \(2 pixels\) is not in map\.csv"):
        LEGEND.of_numbers(np.array([[0, 7], [7, 300]]), schemes["tomic2019"], source="a.png")


def test_scores_of_one_class_are_summed_and_the_sky_left_out(schemes):
    legend = Legend.of_rows([(0, "road", "road"), (1, "path", "sidewalk"), (2, "sky", None), (3, "car", "car")], "m")
    given = np.array([[[0.2, 0.1, 0.5, 0.2], [0, 0, 1, 0]]])
    found = legend.of_scores(given, schemes["tomic2019"], source="a.npz")
    assert found[0, 0, [0, 7]].tolist() == pytest.approx([0.6, 0.4]) and found[0, 0].sum() == pytest.approx(1)
    assert np.isnan(found[0, 1]).all()  # nothing but sky
    with pytest.raises(DataError, match=r"a\.npz: has 3 classes, m names 4 from 0"):
        legend.of_scores(given[:, :, :3], schemes["tomic2019"], source="a.npz")


def test_legends_that_are_wrong_are_named(schemes):
    with pytest.raises(ParameterError, match=r"m: class number 3 is repeated"):
        Legend.of_rows([(3, "a", None), (3, "b", None)], "m")
    with pytest.raises(ParameterError, match=r"m: class number -1 is not in 0 to 65535"):
        Legend.of_rows([(-1, "a", None)], "m")
    with pytest.raises(ParameterError, match="m: names no classes"):
        Legend.of_rows([], "m")
    with pytest.raises(
        ParameterError, match=r"m: 'street' is neither a class of scheme 'tomic2019' nor of the taxonomy"
    ):
        Legend.of_rows([(0, "a", "street")], "m").labels(schemes["tomic2019"])
    small = ClassScheme("small", ("ground",), (("road",),), (), (2,))
    with pytest.raises(UnknownClassError, match="scheme 'small'"):
        Legend.of_rows([(0, "a", "car")], "m").labels(small)

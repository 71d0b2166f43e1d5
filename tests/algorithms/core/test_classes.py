"""The taxonomy, codings and class schemes."""

import numpy as np
import pytest

from mlsroad_pipeline.algorithms.core.classes import IGNORE, TAXONOMY, ClassScheme
from mlsroad_pipeline.algorithms.core.codings import Coding
from mlsroad_pipeline.algorithms.core.exceptions import ParameterError, UnknownClassError

SCHEME = ClassScheme.from_config(
    "two",
    {
        "classes": {
            "ground": {"members": ["road", "grass"], "asprs": 2},
            "pole": {"members": ["light_pole", "post"], "asprs": 64},
        },
        "ignore": ["unlabelled"],
    },
)


def test_taxonomy_codes_are_unique_and_fit_a_byte():
    codes = list(TAXONOMY.values())
    assert len(set(codes)) == len(codes)
    assert min(codes) >= 0 and max(codes) <= 255


def test_coding_names_unknown_codes_their_count_and_the_file():
    coding = Coding("oakland", {1200: "other_ground", 1400: "building"})
    assert coding.encode([1200, 1400, 1200]).tolist() == [10, 20, 10]
    with pytest.raises(UnknownClassError, match=r"block\.gz: .*'oakland'.*9999 \(2 points\)"):
        coding.encode([1200, 9999, 9999], source="block.gz")


def test_coding_refuses_a_class_outside_the_taxonomy():
    with pytest.raises(ParameterError, match="code 7 names 'dragon'"):
        Coding("odd", {7: "dragon"})


def test_scheme_numbers_classes_without_gaps_and_keeps_ignored_apart():
    codes = np.array([TAXONOMY[n] for n in ("grass", "post", "unlabelled", "road")], dtype=np.uint8)
    assert SCHEME.encode(codes).tolist() == [0, 1, IGNORE, 0]
    assert SCHEME.labels_of(["pole"]) == [1]
    with pytest.raises(ParameterError, match="no class 'car'"):
        SCHEME.labels_of(["car"])


def test_scheme_names_unknown_codes():
    with pytest.raises(UnknownClassError, match=r"a\.las: .*50 \(1 points\)"):
        SCHEME.encode([TAXONOMY["car"]], source="a.las")


@pytest.mark.parametrize(
    ("config", "message"),
    [
        ({"classes": {"a": {"members": ["dragon"], "asprs": 2}}}, "'dragon' is not in the taxonomy"),
        ({"classes": {"a": {"members": ["road"], "asprs": 2}}, "ignore": ["road"]}, "'road' is listed twice"),
        ({"classes": {"a": {"members": ["road"], "asprs": 300}}}, "LAS codes must be in 0..255"),
    ],
)
def test_scheme_refuses_bad_configuration(config, message):
    with pytest.raises(ParameterError, match=message):
        ClassScheme.from_config("bad", config)


FINE = ClassScheme.from_config(
    "fine",
    {
        "classes": {
            "road": {"members": ["road"], "asprs": 11},
            "grass": {"members": ["grass"], "asprs": 2},
            "post": {"members": ["post"], "asprs": 64},
        },
        "ignore": ["unlabelled"],
    },
)


def test_a_scheme_coarsens_into_one_it_nests_in():
    assert FINE.coarsen(SCHEME).tolist() == [0, 0, 1]
    assert FINE.codes().tolist() == [11, 2, 64]
    assert FINE.codes(SCHEME).tolist() == [64, 64, 65]
    with pytest.raises(ParameterError, match="class 'ground' of scheme 'two' falls into 2 classes of scheme 'fine'"):
        ClassScheme.from_config("two", {"classes": {"ground": {"members": ["road", "grass"], "asprs": 2}}}).coarsen(
            FINE
        )

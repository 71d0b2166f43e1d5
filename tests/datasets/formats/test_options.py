"""Options: what they refuse, and that they can be built from configuration."""

import numpy as np
import pytest

from mlsroad_pipeline.algorithms.classes import Coding
from mlsroad_pipeline.algorithms.exceptions import ParameterError
from mlsroad_pipeline.datasets.formats.base import ReadOptions, WriteOptions


def test_from_configuration():
    options = ReadOptions.from_config(
        {"columns": {"label": "class"}, "units": "millimetre", "coding": {"7": "road"}, "only": ["label"]}
    )
    assert options == ReadOptions(
        {"label": "class"}, "millimetre", Coding("of the options", {7: "road"}), only=("label",)
    )
    assert options.metres == 0.001
    assert ReadOptions.from_config(None) == ReadOptions()
    assert WriteOptions.from_config({"units": 2}).metres == 2.0
    np.testing.assert_array_equal(ReadOptions(coding="taxonomy").coding.encode([0, 90]), [0, 90])
    with pytest.raises(ParameterError, match=r"unknown ReadOptions colums, unit \(known: columns, units, "):
        ReadOptions.from_config({"unit": "metre", "colums": {}})
    with pytest.raises(ParameterError, match=r"unknown WriteOptions scales"):
        WriteOptions.from_config({"scales": 1})


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"units": "parsec"}, r"units must be one of metre, .* got 'parsec'"),
        ({"units": 0}, r"units as a factor .* got 0"),
        ({"units": True}, r"units as a factor .* got True"),
        ({"units": float("nan")}, r"units as a factor .* got nan"),
        ({"coding": "oakland"}, r"coding must be 'taxonomy' or a mapping .* got 'oakland'"),
        ({"coding": {1: "moon"}}, r"code 1 names 'moon'"),
        ({"delimiter": ", "}, r"delimiter must be one character or 'whitespace', got ', '"),
        ({"comment": ""}, r"comment must not be empty"),
        ({"intensity_scale": "half"}, r"intensity_scale must be .* got 'half'"),
        ({"intensity_scale": -1}, r"intensity_scale must be .* got -1"),
        ({"rgb_bits": 12}, r"rgb_bits must be 8, 16 or None, got 12"),
        ({"n_threads": 0}, r"n_threads must be at least 1, got 0"),
    ],
)
def test_reading_refuses(options, message):
    with pytest.raises(ParameterError, match=message):
        ReadOptions(**options)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"scale": 0}, r"scale must be a finite number > 0, got 0"),
        ({"units": "ell"}, r"units must be one of"),
        ({"delimiter": ""}, r"delimiter must be one character, got ''"),
        ({"decimals": 16}, r"decimals must be in 0\.\.15, got 16"),
        ({"n_threads": 0}, r"n_threads must be at least 1"),
    ],
)
def test_writing_refuses(options, message):
    with pytest.raises(ParameterError, match=message):
        WriteOptions(**options)

"""Options: what they refuse, and that they can be built from configuration."""

import numpy as np
import pytest
from helpers.formats import make_las

from mlsroad_pipeline.algorithms.core.codings import Coding
from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.formats.base import ReadOptions, WriteOptions
from mlsroad_pipeline.formats.registry import get_format


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
    with pytest.raises(ParameterError, match="unknown ReadOptions colums, unit"):
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
        ({"columns": 5}, r"columns must map standard names .* got 5"),
        ({"columns": {"rgb": [4, 5]}}, r"columns\.rgb must be three columns, by name or by index, got \[4, 5\]"),
        ({"columns": {"rgb": "abc"}}, r"columns\.rgb must be three columns, .* got 'abc'"),
        ({"columns": {"label": [1, 2]}}, r"columns\.label must be a column, by name or by index, got \[1, 2\]"),
        ({"columns": {"x": 1.5}}, r"columns\.x must be a column, .* got 1\.5"),
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


def test_every_guess_is_told_once_and_how_to_change_it(tmp_path, rng, caplog):
    make_las(tmp_path / "a.las", rng, point_format=7)
    (tmp_path / "b.csv").write_text("x,y,z,reflectance,red,green,blue\n1,2,3,40,0.5,1.0,0.25\n4,5,6,200,0,0,0\n")
    with caplog.at_level("INFO"):
        for name in ("a.las", "b.csv"):
            form = get_format(tmp_path / name)
            for start in (0, 1, 0):
                form.read(tmp_path / name, ReadOptions(), start=start, stop=start + 1)
    for text in (
        "a.las: intensity (uint16) is divided by 65535; intensity_scale changes that",
        "a.las: colours are read as 16 bits in fields of 16; rgb_bits changes that",
        "b.csv: column 'reflectance' is read as intensity",
        "b.csv: intensity (float64) is divided by 255; intensity_scale changes that",
        "b.csv: colours are fractional numbers up to 1",
    ):
        assert caplog.text.count(text) == 1, text
    caplog.clear()
    with caplog.at_level("INFO"):
        get_format(tmp_path / "a.las").read(tmp_path / "a.las", ReadOptions(intensity_scale=65535, rgb_bits=16))
    assert "is divided by" not in caplog.text and "colours are read as" not in caplog.text

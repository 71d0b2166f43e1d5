"""Values of the parameters of `label`, and names of its output that cannot be."""

import pytest

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.execution.run_identity import run_folder
from mlsroad_pipeline.surveys.parameters import LabelParameters


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"copc": "maybe"}, "label.copc must be true or false, got 'maybe'"),
        ({"overwrite": 1}, "label.overwrite must be true or false, got 1"),
        ({"scheme": ["a"]}, r"label.scheme must be a single value, got \['a'\]"),
        ({"trajectory": 3}, "label.trajectory must be the name of a file, got 3"),
        ({"read": 3}, "label.read must have parameters below it, got 3"),
        ({"inventory": None}, "label.inventory must have parameters below it, got None"),
        ({"markings": 3}, "label.markings must have parameters below it, or be null, got 3"),
        ({"markings": {"contrast": 1.0}}, r"label.markings has no parameter 'contrast' \(parameters: least_contrast, "),
        (
            {"markings": {"least_contrast": "high"}},
            "label.markings.least_contrast must be a finite number > 0, got 'high'",
        ),
        ({"markings": {"least_length": -1.0}}, "label.markings.least_length must be a finite number > 0, got -1.0"),
    ],
)
def test_a_wrong_value_is_an_error(values, message):
    with pytest.raises(ParameterError, match=message):
        LabelParameters(survey="a.laz", output="out", **values)


def test_parameters_of_markings_have_defaults_and_null_lists_none():
    given = LabelParameters(survey="a.laz", output="out", markings={"least_length": 3})
    assert (given.least_contrast, given.least_marking) == (2.0, 3.0)
    assert LabelParameters(survey="a.laz", output="out", markings=None).least_contrast is None


@pytest.mark.parametrize("name", ["a{b}", "two\nlines"])
def test_an_output_that_kedro_or_sqlite_cannot_open_is_an_error(tmp_path, name):
    with pytest.raises(ParameterError, match="choose another folder"):
        run_folder({"label": {"survey": "a.laz", "output": str(tmp_path / name)}})

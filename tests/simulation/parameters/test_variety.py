import numpy as np
import pytest

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.simulation import SCANNERS
from mlsroad_pipeline.simulation.parameters.devices import Variation
from mlsroad_pipeline.simulation.parameters.presets import expanded_surveys, simulation_parameters
from mlsroad_pipeline.surveys.simulated import selected_surveys

MANY = {
    "count": 12, "presets": ["hdl64", "pandaset", "small"], "streets": ["residential", "rural"], "seed": 4,
    "variety": 1.0, "length": 24,
}  # fmt: skip


def test_many_surveys_are_drawn_from_one_description_alike_every_time():
    surveys = expanded_surveys({"one": {"preset": "tiny"}, "train_many": MANY, "off": None})
    assert list(surveys) == ["one", *(f"train_many_{k:03d}" for k in range(12)), "off"]
    assert surveys == expanded_surveys({"one": {"preset": "tiny"}, "train_many": MANY, "off": None})
    drawn = [surveys[name] for name in surveys if name.startswith("train")]
    # Every pair of a preset and a kind of street comes twice.
    pairs = [(one["preset"], one["street"]["kind"]) for one in drawn]
    assert sorted(pairs) == sorted(2 * [(p, s) for p in MANY["presets"] for s in MANY["streets"]])
    assert len({one["seed"] for one in drawn}) == 12
    parameters = [simulation_parameters(one) for one in drawn]
    assert {p.length for p in parameters} == {24}
    for name in ("pulse_rate", "range_noise", "sensitivity", "pitch"):
        assert len({getattr(p.devices[0], name) for p in parameters}) == 12
    # Scanners at a fraction of their rate stay there.
    assert (
        max(p.devices[0].pulse_rate for p, one in zip(parameters, drawn, strict=True) if one["preset"] == "small") < 8e4
    )


def test_without_variety_scanners_and_objects_are_those_of_preset_and_kind():
    (one,) = expanded_surveys({"x": {**MANY, "count": 1, "variety": 0.0}}).values()
    plain = simulation_parameters({"preset": "hdl64", "seed": one["seed"], "length": 24, "street": "residential"})
    assert simulation_parameters(one) == plain


def test_factors_change_the_numbers_of_objects_alone():
    plain = expanded_surveys({"x": MANY})
    more = expanded_surveys({"x": {**MANY, "factors": {"people": 3.0, "signs": 0.5}}})
    for one, other in zip(plain.values(), more.values(), strict=True):
        assert other["street"]["people"] == pytest.approx(min(3.0 * one["street"]["people"], 5.0), abs=0.02)
        assert other["street"]["signs"] == pytest.approx(0.5 * one["street"]["signs"], abs=0.02)
        same = {key: value for key, value in one["street"].items() if key not in ("people", "signs")}
        assert same.items() <= other["street"].items() and one["varied"] == other["varied"]


def test_one_of_many_or_all_of_them_may_be_selected():
    simulation = {"enabled": True, "surveys": {"a": {"preset": "tiny"}, "b": MANY}}
    assert len(selected_surveys({**simulation, "only": None})) == 13
    assert list(selected_surveys({**simulation, "only": "b"})) == [f"b_{k:03d}" for k in range(12)]
    assert list(selected_surveys({**simulation, "only": "b_003"})) == ["b_003"]
    with pytest.raises(ParameterError, match=r"unknown simulation.only 'b_012'"):
        selected_surveys({**simulation, "only": "b_012"})


def test_a_variation_turns_raises_and_thins_a_scanner():
    system = SCANNERS["hdl64"]
    changed = Variation(height=0.2, pitch=2.0, roll=-1.0, rate=0.5, top=-5.0, dropout=0.1).applied(system)
    before, after = system.devices[0], changed.devices[0]
    assert changed.platform == pytest.approx(system.platform + 0.2)
    up = after.mounting[:, 0]  # the axis of an upright head
    np.testing.assert_allclose(np.degrees([np.arcsin(up[0]), -np.arcsin(up[1])]), [2.0, -1.0], atol=0.01)
    assert max(after.elevations) <= -5.0 and after.step == pytest.approx(2 * before.step)
    assert after.dropout == pytest.approx(0.102)
    assert Variation().applied(system) == system


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"count": 0}, "b: count must be an integer >= 1, got 0"),
        ({"presets": []}, "b: presets must be some of tiny, .* got none"),
        ({"streets": ["alley"]}, "b: streets must be some of town, .* got alley"),
        ({"variety": 1.5}, "b: variety must be between 0 and 1, got 1.5"),
        ({"factors": {"cars": 2}}, "b: factors .* got cars"),
    ],
)
def test_bad_descriptions_are_named(changes, message):
    with pytest.raises(ParameterError, match=message):
        expanded_surveys({"b": {**MANY, **changes}})
    with pytest.raises(ParameterError, match="two simulated surveys are named 'b_001'"):
        expanded_surveys({"b_001": None, "b": MANY})
    with pytest.raises(ParameterError, match="varied: unknown keys pich"):
        simulation_parameters({"varied": {"pich": 1.0}})

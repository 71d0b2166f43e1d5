"""Comparison of a survey with the training data of a model: ranges of facts, and sentences on unusual facts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from mlsroad_pipeline.algorithms.core.exceptions import DataError

QUANTILES = (0.0, 0.05, 0.5, 0.95, 1.0)
"""Quantiles of a fact over the training scenes. The ends are extremes: a few dense streets among many scans count."""

TrainingFacts = Mapping[str, Sequence[float]]


class _Fact(NamedTuple):
    """Words about a fact: text before and after its value, unit, and whether it is a share or compares by its ratio."""

    before: str
    after: str = ""
    unit: str = ""
    share: bool = False
    ratio: bool = False


_FACTS = {
    "density": _Fact("the median density is", unit=" points per m²", ratio=True),
    "spacing": _Fact("points lie", " apart (median)", " m", ratio=True),
    "height": _Fact("the highest points (99 % quantile) are", " above the lowest around them", " m", ratio=True),
    "above_2": _Fact("", " of the points are more than 2 m high", share=True),
    "above_5": _Fact("", " of the points are more than 5 m high", share=True),
    "ground": _Fact("", " of the points are close to the ground", share=True),
    "concentration": _Fact("the concentration about one place is"),
    "intensities": _Fact("the intensity has", " distinct values", ratio=True),
    "linear": _Fact("", " of the neighbourhoods are linear", share=True),
    "planar": _Fact("", " of the neighbourhoods are planar", share=True),
    "scattered": _Fact("", " of the neighbourhoods are scattered", share=True),
}
_SHARE_MARGIN, _RATIO_MARGIN, _MARGIN = 0.03, 1.25, 0.05
_LEAST = 1e-3


def training_facts(scenes: Sequence[Mapping[str, float]]) -> dict[str, list[float]]:
    """Return the range of each fact over the training scenes.

    Examples
    --------
    >>> training_facts([{"spacing": 0.02}, {"spacing": 0.04}, {"spacing": 0.06}])
    {'spacing': [0.02, 0.022, 0.04, 0.058, 0.06]}
    """
    found = {name: [scene[name] for scene in scenes if name in scene] for name in _FACTS}
    return {
        name: [float(f"{value:.4g}") for value in np.quantile(values, QUANTILES).tolist()]
        for name, values in found.items()
        if values
    }


def median_facts(scenes: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Return the median of each fact over scenes of a survey."""
    names = [name for name in _FACTS if any(name in scene for scene in scenes)]
    return {name: float(np.median([scene[name] for scene in scenes if name in scene])) for name in names}


def unusual_facts(facts: Mapping[str, float], training: TrainingFacts) -> list[str]:
    """Return one sentence per fact that is outside the range of the training scenes.

    The range is that between the least and the largest value, widened by 0.03 (shares), 0.05 (concentration) or a
    quarter of the value (others).

    Examples
    --------
    >>> unusual_facts({"spacing": 0.9}, {"spacing": [0.02, 0.03, 0.1, 0.4, 0.5]})
    ['points lie 0.9 m apart (median; training scenes 0.02 to 0.5 m)']
    """
    sentences = []
    for name, fact in _FACTS.items():
        if name in facts and name in training:
            low, *_, high = _range(name, training)
            if not _lowest(low, fact) <= facts[name] <= _highest(high, fact):
                sentences.append(_sentence(fact, facts[name], low, high))
    return sentences


def _range(name: str, training: TrainingFacts) -> Sequence[float]:
    if len(training[name]) != len(QUANTILES):
        raise DataError(f"training_facts of {name!r} must have {len(QUANTILES)} quantiles, got {training[name]!r}")
    return training[name]


def _least_width(fact: _Fact) -> float:
    return float(np.log(_RATIO_MARGIN)) if fact.ratio else _SHARE_MARGIN if fact.share else _MARGIN


def _lowest(low: float, fact: _Fact) -> float:
    return low / _RATIO_MARGIN if fact.ratio else low - _least_width(fact)


def _highest(high: float, fact: _Fact) -> float:
    return high * _RATIO_MARGIN if fact.ratio else high + _least_width(fact)


def _sentence(fact: _Fact, value: float, low: float, high: float) -> str:
    def text(number: float) -> str:
        return f"{100 * number:.0f}" if fact.share else f"{number:.3g}" if number < 1000 else f"{number:,.0f}"

    unit = " %" if fact.share else fact.unit
    training = f"training scenes {text(low)} to {text(high)}{unit}"
    after = f"{fact.after[:-1]}; {training})" if fact.after.endswith(")") else f"{fact.after} ({training})"
    return f"{fact.before} {text(value)}{unit}{after}".strip()

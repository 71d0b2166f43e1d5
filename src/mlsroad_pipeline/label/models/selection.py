"""Selection of the model that labels a survey: a named one, the champion, or a shipped one by the survey.

No function needs a Kedro session.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.models.methods import METHODS
from mlsroad_pipeline.algorithms.quality.training_facts import distance_from_training, unusual_facts
from mlsroad_pipeline.datasets.models.registered_models import ModelStore, RegisteredVersion
from mlsroad_pipeline.datasets.models.shipped_models import ShippedModel, shipped_models
from mlsroad_pipeline.label.models.choice import ModelChoice, StoredModel
from mlsroad_pipeline.label.models.survey_facts import (
    SCAN_BELOW,
    SCAN_CONCENTRATION,
    SPARSE_BELOW,
    SurveyFacts,
    facts_of_survey,
)
from mlsroad_pipeline.surveys.inspection import InspectParameters

CHAMPION = "champion"
"""Alias of the registered model that `label` prefers to the shipped ones."""

POOL, GENERAL, SPARSE, DENSE = "pool", "general", "sparse", "dense"
"""Names of shipped models: the default, one of its members, and those that a method without these has."""


def explain_choice(
    survey: str | Sequence[str],
    *,
    method: str | None = None,
    model: int | str | None = None,
    store: ModelStore | None = None,
    parameters: InspectParameters | None = None,
) -> ModelChoice:
    """Return the model that `label` would take for a file, folder or glob, and the reason."""
    return choose(facts_of_survey(survey, parameters=parameters), method=method, model=model, store=store)


def choose(
    facts: SurveyFacts, *, method: str | None = None, model: int | str | None = None, store: ModelStore | None = None
) -> ModelChoice:
    """Return the model for a survey: a named one or the champion (`named_choice`), else a shipped one."""
    return named_choice(method=method, model=model, store=store) or shipped_choice(facts, method=method)


def named_choice(
    *, method: str | None = None, model: int | str | None = None, store: ModelStore | None = None
) -> ModelChoice | None:
    """Return the model that configuration and registry determine without the survey.

    Parameters
    ----------
    method : str, optional
        Method of the model (``label.method``).
    model : int or str, optional
        Name of a shipped model, version or alias of a registered one, or folder of a model (``label.model``).
    store : ModelStore, optional
        Registered models; None for none.

    Returns
    -------
    ModelChoice or None
        The model and the reason; None if a shipped model is to be chosen by the survey.

    Raises
    ------
    ParameterError
        If the method or the model is unknown or ambiguous, several models are champions, or the method has no model.
    """
    shipped = shipped_models()
    registered = () if store is None else tuple(store.versions())
    _check_method(method, registered)
    if model is not None and str(model) in shipped:
        return _named_shipped(shipped[str(model)], method)
    own = [item for item in registered if method in (None, item.method)]
    if model is not None and Path(str(model), "model.json").is_file():
        return _named_folder(str(model), method)
    if model is not None:
        return ModelChoice(_named_registered(str(model), own, method, shipped, store), f"label.model is {model}")
    champions = [item for item in own if CHAMPION in item.aliases and (method is not None or _labels_points(item))]
    if len(champions) > 1:
        both = " and ".join(item.name for item in champions)
        raise ParameterError(f"{both} have the alias {CHAMPION!r}: remove one, or name a method (label.method=SLUG)")
    if champions:
        return ModelChoice(champions[0], f"it has the alias {CHAMPION!r}")
    if method is not None and own:
        return ModelChoice(own[-1], f"it is the highest version of label.method={method}")
    if method is not None and method not in {item.method for item in shipped.values()}:
        command = f"kedro run --pipelines=all_methods --to-outputs={method}.registered_model"
        raise ParameterError(
            f"label.method {method!r} has no model: the package ships none and none is registered; `{command}`, in a "
            "clone of the project, trains one"
        )
    return None


def shipped_choice(facts: SurveyFacts, *, method: str | None = None) -> ModelChoice:
    """Return the shipped model whose training data are nearest to a survey.

    Models without facts of their training data are not compared: `POOL` is taken, else the one for the density.
    """
    shipped = {name: item for name, item in shipped_models().items() if method in (None, item.method)}
    if not shipped:
        raise ParameterError("the package holds no models: install mlsroad_pipeline again")
    if POOL in shipped:
        shipped.pop(GENERAL, None)  # a member of the pool, with the same training data
    if len(shipped) == 1:
        of = "" if method is None else f" of {method}"
        return ModelChoice(next(iter(shipped.values())), f"it is the only shipped model{of}")
    described = [item for item in shipped.values() if item.training_facts]
    if len(described) > 1 and facts.of_scenes:
        return _nearest_in_training(described, facts.of_scenes)
    if POOL in shipped:
        return ModelChoice(shipped[POOL], "it is the default model of the package")
    model = shipped.get(SPARSE if facts.sparse else DENSE, next(iter(shipped.values())))
    return ModelChoice(model, _reason(facts))


def _nearest_in_training(models: Sequence[ShippedModel], facts: Mapping[str, float]) -> ModelChoice:
    """Return the model with the fewest unusual facts; of equal ones that with the smallest mean distance."""

    def order(model: ShippedModel) -> tuple[int, float]:
        distance = distance_from_training(facts, model.training_facts)
        return len(unusual_facts(facts, model.training_facts)), float("inf") if np.isnan(distance) else distance

    ranked = sorted(models, key=order)
    counts = ", ".join(f"{item.name} {order(item)[0]} (mean distance {order(item)[1]:.2g})" for item in ranked)
    return ModelChoice(ranked[0], f"fewest properties of the survey are outside its training data: {counts}")


def _reason(facts: SurveyFacts) -> str:
    if np.isnan(facts.median_density):
        return "the density of the survey is unknown"
    text = f"the survey has a median of {facts.median_density:.4g} points per m²"
    if facts.median_density < SPARSE_BELOW:
        return f"{text}, below {SPARSE_BELOW:g}"
    if facts.median_density >= SCAN_BELOW:
        return f"{text}, at least {SCAN_BELOW:g}"
    side = "below" if facts.sparse else "at least"
    scan = "" if facts.sparse else "not "
    concentration = f"concentration {facts.concentration:.2g}, {side} {SCAN_CONCENTRATION:g}"
    return f"{text} and is {scan}a scan from one place ({concentration})"


def _labels_points(item: RegisteredVersion) -> bool:
    return item.method not in METHODS or METHODS[item.method].task == "labelling"


def _check_method(method: str | None, registered: Sequence[RegisteredVersion]) -> None:
    shipped = (item.method for item in shipped_models().values())
    known = list(dict.fromkeys((*METHODS, *shipped, *(item.method for item in registered))))
    if method is not None and method not in known:
        raise ParameterError(f"label.method {method!r} is no method (methods: {', '.join(known)})")


def _named_shipped(model: ShippedModel, method: str | None) -> ModelChoice:
    if method not in (None, model.method):
        raise ParameterError(f"label.model {model.name!r} is a model of {model.method}, label.method is {method!r}")
    return ModelChoice(model, f"label.model is {model.name}")


def _named_folder(folder: str, method: str | None) -> ModelChoice:
    model = StoredModel.at(folder)
    if method not in (None, model.method):
        raise ParameterError(f"label.model {folder!r} is a model of {model.method}, label.method is {method!r}")
    return ModelChoice(model, "label.model is this folder")


def _named_registered(
    model: str,
    own: Sequence[RegisteredVersion],
    method: str | None,
    shipped: Mapping[str, ShippedModel],
    store: ModelStore | None,
) -> RegisteredVersion:
    """Return the registered model with a version or an alias."""
    named = [item for item in own if model in (str(item.version), *item.aliases)]
    if len(named) == 1:
        return named[0]
    if named:
        names = ", ".join(item.name for item in named)
        raise ParameterError(f"label.model {model!r} is ambiguous: name a method too (label.method=SLUG), for {names}")
    there = [f"{name} (shipped)" for name in shipped]
    there += [" or ".join((item.name, *item.aliases)) for item in own]
    where = " and there is no MLflow store (MLFLOW_TRACKING_URI is not set)" if store is None else ""
    about = "" if method is None else f" of {method}"
    raise ParameterError(f"label.model {model!r}{about} is unknown{where}; models: {', '.join(there)}")

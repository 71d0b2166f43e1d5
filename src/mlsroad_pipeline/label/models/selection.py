"""Selection of the model that labels a survey: a named one, the champion, or a shipped one.

No function needs a Kedro session.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.models.methods import METHODS, trained_methods
from mlsroad_pipeline.label.models.choice import ModelChoice, StoredModel
from mlsroad_pipeline.model_store.registered_models import ModelStore, RegisteredVersion
from mlsroad_pipeline.model_store.shipped_models import ShippedModel, shipped_models

CHAMPION = "champion"
"""Alias of the registered model that `label` prefers to the shipped ones."""

DEFAULT = "pool"
"""Name of the shipped model that `label` takes by default."""


def choose_model(
    *, method: str | None = None, model: int | str | None = None, store: ModelStore | None = None
) -> ModelChoice:
    """Return the model of a run of `label`."""
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
    return _default(method)


def _default(method: str | None) -> ModelChoice:
    """Return the shipped model of a method; of none that of the package."""
    shipped = shipped_models()
    if method is None:
        if DEFAULT not in shipped:
            raise ParameterError(f"the package has no model {DEFAULT!r}: install mlsroad_pipeline again")
        return ModelChoice(shipped[DEFAULT], "it is the default model of the package")
    own = [item for item in shipped.values() if item.method == method]
    if not own:
        command = f"kedro run --pipelines=all_methods --to-outputs={method}.registered_model"
        how = (
            f"`{command}`, in a clone of the project, trains one"
            if method in trained_methods()
            else "see mlsroad learn"
        )
        raise ParameterError(
            f"label.method {method!r} has no model: the package ships none and none is registered; {how}"
        )
    return ModelChoice(own[0], f"it is the only shipped model of {method}")


def _labels_points(item: RegisteredVersion) -> bool:
    return item.method not in METHODS or METHODS[item.method].task == "labelling"  # loading reports unknown methods


def _check_method(method: str | None, registered: Sequence[RegisteredVersion]) -> None:
    known = list(dict.fromkeys((*METHODS, *(item.method for item in registered))))
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

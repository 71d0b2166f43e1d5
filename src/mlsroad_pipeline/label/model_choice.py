"""Models that `label` can use, choice of one of them, and its loading. No function needs a Kedro session."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from mlsroad_pipeline.algorithms.core.classes import find_scheme
from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.models.given_labels.labeller import SLUG as GIVEN_LABELS
from mlsroad_pipeline.algorithms.models.labelling import method_of
from mlsroad_pipeline.algorithms.models.methods import METHODS, trained_methods
from mlsroad_pipeline.model_store.bundle_files import load_bundle
from mlsroad_pipeline.model_store.registered_models import MlflowStore, ModelStore, RegisteredVersion, configured_store
from mlsroad_pipeline.model_store.shipped_models import ShippedModel, load_shipped, shipped_models


@dataclass(frozen=True)
class StoredModel:
    """A model in a folder, as `mlsroad learn` writes it where no MLflow store is configured."""

    folder: str  # The folder
    method: str  # Slug of the method
    trained_on: str = ""  # Training data

    @property
    def name(self) -> str:
        """Return the folder."""
        return self.folder

    @classmethod
    def at(cls, folder: str) -> StoredModel:
        """Return the model of a folder; ReadError if it is damaged."""
        bundle = load_bundle(folder)
        facts = bundle.metadata.get("trained_on", {})
        text = ", ".join(f"{name} {value}" for name, value in facts.items()) if isinstance(facts, Mapping) else ""
        return cls(folder, bundle.slug, text)

    def load(self) -> ModelBundle:
        """Return the bundle; its metadata gain ``stored``."""
        bundle = load_bundle(self.folder)
        stored = {"name": Path(self.folder).name, "version": "", "folder": self.folder}
        return replace(bundle, metadata={**bundle.metadata, "stored": stored})


@dataclass(frozen=True)
class ModelChoice:
    """The chosen model."""

    model: ShippedModel | RegisteredVersion | StoredModel  # The model
    reason: str  # Reason of the choice, in one line

    @property
    def method(self) -> str:
        """Return the slug of the method."""
        return self.model.method

    @property
    def name(self) -> str:
        """Return the name of the model, with its version if it is a registered one."""
        return f"the shipped model {self.model.name}" if isinstance(self.model, ShippedModel) else self.model.name

    @property
    def trained_on(self) -> str:
        """Return the training data."""
        return f"trained on {self.model.trained_on or 'unknown data'}"


def load_choice(choice: ModelChoice, store: ModelStore | None = None) -> ModelBundle:
    """Return the bundle of a chosen model; ParameterError if its method is unknown."""
    bundle = _loaded(choice, store)
    method_of(bundle)
    return bundle


def _loaded(choice: ModelChoice, store: ModelStore | None) -> ModelBundle:
    if isinstance(choice.model, ShippedModel):
        return load_shipped(choice.model.name)
    if isinstance(choice.model, StoredModel):
        return choice.model.load()
    if store is None:
        raise ParameterError(f"{choice.name} needs an MLflow store: set MLFLOW_TRACKING_URI")
    return store.load(choice.model)


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
    known = list(dict.fromkeys((*METHODS, *(item.method for item in registered))))
    if method is not None and method not in known:
        raise ParameterError(f"unknown label.method {method!r} (known: {', '.join(known)})")
    if model is not None and str(model) in shipped:
        return _named(shipped[str(model)], method, f"label.model is {model}")
    own = [item for item in registered if method in (None, item.method)]
    if model is not None and Path(str(model), "model.json").is_file():
        return _named(StoredModel.at(str(model)), method, "label.model is this folder")
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


def _named(model: ShippedModel | StoredModel, method: str | None, reason: str) -> ModelChoice:
    if method not in (None, model.method):
        raise ParameterError(f"label.model {model.name!r} is a model of {model.method}, label.method is {method!r}")
    return ModelChoice(model, reason)


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


logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class ModelRequest:
    """Model that a run of `label` requests."""

    method: str | None = None  # Method of the model
    choice: ModelChoice | None = None  # The model; the shipped one of the method by default
    images: Any = None  # Segmentation of images in place of the network of the model
    own: ModelBundle | None = None  # A model that the configuration makes, in place of a registered one
    device: str = "auto"  # Where images are segmented

    def bundle(self) -> tuple[ModelBundle, str]:
        """Return the model and a line for the log."""
        if self.own is not None and self.own.slug == GIVEN_LABELS:
            return self.own, "Labelling with the given classes alone (label.given)"
        if self.own is not None:
            source = self.own.metadata["segmentation"]["name"]
            return self.own, f"Labelling with image_labels ({source}): image_labels.masks or .weights names it"
        choice = self.choice or choose_model(method=self.method)
        bundle = _segmentation("with_device")(load_choice(choice, configured_store()), self.device)
        if self.images is not None:
            bundle = _segmentation("with_own_segmentation")(bundle, self.images)
        return bundle, f"Labelling with {choice.name} ({bundle.slug}, {choice.trained_on}): {choice.reason}"


def image_request(request: ModelRequest, images: Any, schemes: Mapping[str, Any]) -> ModelRequest:
    """Return a request with the masks or the weights that the configuration names for `image_labels` or `fusion`."""
    if not images.own_segmentation:
        return replace(request, device=images.device)
    given = "masks" if images.masks is not None else "weights"
    chosen = request.choice.method if request.choice else request.method
    if chosen == "fusion":
        logger.warning(
            "The fusion was learned with another segmentation than %s unless it was trained with the same",
            images.masks or images.weights,
        )
        return replace(request, images=images)
    if chosen == "image_labels" and request.choice is not None:
        named = f"{request.choice.name} ({request.choice.reason})"
        raise ParameterError(
            f"image_labels.{given} takes the place of {named}: set label.model to null and label.method to "
            f"image_labels (image_labels.scheme has the classes), or image_labels.{given} to null"
        )
    if request.method == "image_labels":
        return replace(request, own=_segmentation("own_model")(images, find_scheme(schemes, images.scheme)))
    raise ParameterError(f"image_labels.{given} is set: use label.method=image_labels or fusion, or set it to null")


def _segmentation(name: str) -> Any:
    """Return a function of the method `image_labels` that changes where the images of a model are segmented."""
    return METHODS["image_labels"].function(f".own_segmentation:{name}")


def registered_models_at(uri: str) -> ModelStore:
    """Return the registered models of an MLflow store."""
    return MlflowStore(uri)


def available_models(store: ModelStore | None = None) -> list[ShippedModel | RegisteredVersion]:
    """Return the shipped models, then the registered ones of a store (`MlflowStore`, or None for none)."""
    return [*shipped_models().values(), *(() if store is None else store.versions())]


def model_lines(item: ShippedModel | RegisteredVersion) -> list[str]:
    """Return a model as text: a line with its name, then indented lines on its training and scores."""
    trained = f"  trained on  {item.trained_on or 'unknown data'}"
    if isinstance(item, RegisteredVersion):
        aliases = f" ({', '.join(item.aliases)})" if item.aliases else ""
        return [f"{item.name}{aliases}: {item.method}, registered", trained]
    scores = [
        f"  scores      {score.data}: overall accuracy {score.overall_accuracy:.3f}, mean F1 {score.mean_f1:.3f}"
        for score in item.scores
    ]
    size = sum(int(file["bytes"]) for file in item.files.values()) / 1e6
    return [
        *(f"{item.name}: {item.method}, shipped", trained),
        *(f"  for         {item.summary}", f"  classes     {', '.join(item.classes)}", *scores),
        f"  licence     {item.licence}, {size:.1f} MB",
    ]

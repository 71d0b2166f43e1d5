"""Choice of the model of `label`: default, names, versions, aliases."""

from dataclasses import dataclass

import numpy as np
import pytest

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.label import model_choice
from mlsroad_pipeline.label.model_choice import ModelChoice, available_models, choose_model, load_choice
from mlsroad_pipeline.model_store.bundle_files import save_bundle
from mlsroad_pipeline.model_store.registered_models import RegisteredVersion
from mlsroad_pipeline.model_store.shipped_models import shipped_models


@dataclass(frozen=True)
class Store:
    found: tuple

    def versions(self):
        return self.found


def version(method, number, *aliases):
    return RegisteredVersion(method, number, aliases, "a planted street")


STORE = Store((version("detrended_forest", 1), version("detrended_forest", 2, "best"), version("patch_graph", 1)))


@pytest.mark.parametrize("store", [None, Store(()), STORE])
def test_plain_label_takes_the_default_model(store):
    choice = choose_model(store=store)
    assert choice.model == shipped_models()["pool"] and choice.method == "pool"
    assert choice.reason == "it is the default model of the package"


@pytest.mark.parametrize(("method", "name"), [("boosted_trees", "general"), ("pool", "pool")])
def test_method_without_a_registered_model_takes_its_shipped_one(method, name):
    choice = choose_model(method=method, store=STORE)
    assert (choice.model.name, choice.reason) == (name, f"it is the only shipped model of {method}")


def test_package_without_its_default_model_is_an_error(monkeypatch):
    monkeypatch.setattr(model_choice, "shipped_models", dict)
    with pytest.raises(ParameterError, match="has no model 'pool': install mlsroad_pipeline again"):
        choose_model()


def test_shipped_model_by_its_name():
    assert choose_model(model="general", store=STORE).model.name == "general"
    with pytest.raises(ParameterError, match="'general' is a model of boosted_trees, label.method is 'patch_graph'"):
        choose_model(model="general", method="patch_graph", store=STORE)


@pytest.mark.parametrize(
    ("method", "model", "expected"),
    [
        ("detrended_forest", None, ("detrended_forest", 2)),
        ("detrended_forest", 1, ("detrended_forest", 1)),
        ("detrended_forest", "2", ("detrended_forest", 2)),
        (None, 2, ("detrended_forest", 2)),
        (None, "best", ("detrended_forest", 2)),
        ("patch_graph", None, ("patch_graph", 1)),
    ],
)
def test_registered_models_by_method_version_and_alias(method, model, expected):
    found = choose_model(method=method, model=model, store=STORE).model
    assert (found.method, found.version) == expected


def test_champion_of_a_labelling_method_replaces_the_shipped_models():
    store = Store((version("detrended_forest", 1, "champion"), version("detrended_forest", 2)))
    assert choose_model(store=store).model == store.found[0]
    assert choose_model(method="detrended_forest", store=store).model == store.found[0]
    detector = Store((version("visual_words", 1, "champion"), version("visual_words", 2)))
    assert choose_model(store=detector).model.name == "pool"
    assert choose_model(method="visual_words", store=detector).model == detector.found[0]


def test_two_champions_are_an_error_unless_a_method_is_named():
    store = Store((version("detrended_forest", 3, "champion"), version("patch_graph", 1, "champion")))
    both = "mlsroad-detrended_forest version 3 and mlsroad-patch_graph version 1 have the alias 'champion'"
    with pytest.raises(ParameterError, match=both):
        choose_model(store=store)
    assert choose_model(method="patch_graph", store=store).model == store.found[1]


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"method": "forest"}, r"^unknown label.method 'forest' \(known: detrended_forest, patch_graph, "),
        (
            {"method": "shot"},
            "the package ships none and none is registered; `kedro run --pipelines=all_methods --to-outputs=shot.registered_model`",
        ),
        ({"method": "corrected"}, "the package ships none and none is registered; see mlsroad learn"),
        (
            {"model": 1},
            "'1' is ambiguous: name a method too .* for mlsroad-detrended_forest version 1, mlsroad-patch_g",
        ),
        (
            {"model": "newest"},
            r"'newest' is unknown; models: general \(shipped\), pool \(shipped\), mlsroad-.* or best, ",
        ),
        (
            {"model": 7, "method": "patch_graph"},
            "'7' of patch_graph is unknown; models: .*mlsroad-patch_graph version 1$",
        ),
    ],
)
def test_unknown_names_list_what_there_is(given, message):
    with pytest.raises(ParameterError, match=message):
        choose_model(**given, store=STORE)


def test_version_without_a_store_says_so():
    with pytest.raises(ParameterError, match=r"there is no MLflow store \(MLFLOW_TRACKING_URI is not set\)"):
        choose_model(model=3)


def test_models_are_listed_with_their_origin():
    found = available_models(STORE)
    assert [m.name for m in found[2:]] == [
        "mlsroad-detrended_forest version 1",
        "mlsroad-detrended_forest version 2",
        "mlsroad-patch_graph version 1",
    ]
    assert [m.name for m in found[:2]] == ["general", "pool"]
    assert all(m.scores for m in found[:2])


@dataclass(frozen=True)
class StoreWithModels(Store):
    def load(self, found):
        registered = {"name": found.registered_name, "version": found.version, "run_id": "r"}
        return ModelBundle(found.method, {}, {"classes": ["road"], "registered": registered})


def test_registered_model_of_an_unknown_method_is_refused_in_one_line():
    store = StoreWithModels((version("earlier_forest", 2, "champion"),))
    choice = choose_model(store=store)
    assert choice.model == store.found[0]
    with pytest.raises(
        ParameterError, match=r"^model 'mlsroad-earlier_forest 2': unknown method 'earlier_forest' .*SLUG$"
    ):
        load_choice(choice, store)
    known = StoreWithModels((version("patch_graph", 1),))
    assert load_choice(ModelChoice(known.found[0], ""), known).slug == "patch_graph"


def test_model_of_a_folder_with_an_unknown_method_is_refused(tmp_path):
    save_bundle(ModelBundle("earlier_forest", {"a": np.zeros(1)}, {"classes": ["road"]}), tmp_path / "mine")
    with pytest.raises(ParameterError, match="^model 'mine': unknown method 'earlier_forest'"):
        load_choice(choose_model(model=str(tmp_path / "mine")))

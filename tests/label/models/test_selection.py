"""Choice of the model of `label`: density, names, versions, aliases."""

import re
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
import pytest

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.datasets.models.registered_models import RegisteredVersion
from mlsroad_pipeline.datasets.models.shipped_models import shipped_models
from mlsroad_pipeline.label.models import selection
from mlsroad_pipeline.label.models.available import AvailableModel, available_models, unusual_properties_of
from mlsroad_pipeline.label.models.selection import choose, explain_choice, named_choice, shipped_choice
from mlsroad_pipeline.label.models.survey_facts import SurveyFacts, facts_of_quality

DENSE, SPARSE = SurveyFacts(300.0, 0.9), SurveyFacts(8.0, 0.9)


@dataclass(frozen=True)
class Store:
    found: tuple

    def versions(self):
        return self.found


def version(method, number, *aliases):
    return RegisteredVersion(method, number, aliases, "a planted street")


STORE = Store((version("detrended_forest", 1), version("detrended_forest", 2, "best"), version("patch_graph", 1)))


@pytest.mark.parametrize("store", [None, Store(()), STORE])
@pytest.mark.parametrize(
    ("density", "concentration", "name"),
    [
        (8.9, 0.9, "sparse"),
        (9.0, 0.5, "dense"),
        (9.0, 0.49, "sparse"),
        (14.9, 0.49, "sparse"),
        (15.0, 0.2, "dense"),
        (np.nan, np.nan, "dense"),
    ],
)
def test_plain_label_takes_the_default_and_the_forest_is_chosen_by_the_survey(density, concentration, name, store):
    facts = SurveyFacts(density, concentration)
    choice = choose(facts, store=store)
    assert choice.model == shipped_models()["pool"] and choice.method == "pool"
    assert choice.reason == "it is the default model of the package"
    assert shipped_choice(facts, method="detrended_forest").model == shipped_models()[name]


def test_reason_has_the_figures():
    def reason(facts):
        return choose(facts, method="detrended_forest").reason

    assert reason(SPARSE) == "the survey has a median of 8 points per m², below 9"
    assert reason(DENSE) == "the survey has a median of 300 points per m², at least 15"
    scan = "the survey has a median of 12 points per m² and is a scan from one place (concentration 0.34, below 0.5)"
    assert reason(SurveyFacts(12.0, 0.34)) == scan
    assert "is not a scan from one place (concentration 0.8, at least 0.5)" in reason(SurveyFacts(12.0, 0.8))


def test_shipped_model_by_its_name():
    assert choose(DENSE, model="sparse", store=STORE).model.name == "sparse"
    with pytest.raises(ParameterError, match="'sparse' is a model of detrended_forest, label.method is 'patch_graph'"):
        choose(DENSE, model="sparse", method="patch_graph", store=STORE)


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
    found = choose(DENSE, method=method, model=model, store=STORE).model
    assert (found.method, found.version) == expected


def test_champion_of_a_labelling_method_replaces_the_shipped_models():
    store = Store((version("detrended_forest", 1, "champion"), version("detrended_forest", 2)))
    assert choose(DENSE, store=store).model == store.found[0]
    assert choose(SPARSE, method="detrended_forest", store=store).model == store.found[0]
    detector = Store((version("visual_words", 1, "champion"), version("visual_words", 2)))
    assert choose(DENSE, store=detector).model.name == "pool"
    assert choose(DENSE, method="visual_words", store=detector).model == detector.found[0]


def test_two_champions_are_an_error_unless_a_method_is_named():
    store = Store((version("detrended_forest", 3, "champion"), version("patch_graph", 1, "champion")))
    both = "mlsroad-detrended_forest version 3 and mlsroad-patch_graph version 1 have the alias 'champion'"
    with pytest.raises(ParameterError, match=both):
        choose(DENSE, store=store)
    assert choose(DENSE, method="patch_graph", store=store).model == store.found[1]


def test_method_with_a_shipped_model_alone_takes_it():
    assert choose(SPARSE, method="detrended_forest").model.name == "sparse"


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"method": "forest"}, r"^label.method 'forest' is no method \(methods: detrended_forest, patch_graph, "),
        (
            {"method": "shot"},
            "the package ships none and none is registered; `kedro run --pipelines=all_methods --to-outputs=shot.registered_model`",
        ),
        (
            {"model": 1},
            "'1' is ambiguous: name a method too .* for mlsroad-detrended_forest version 1, mlsroad-patch_g",
        ),
        (
            {"model": "newest"},
            r"'newest' is unknown; models: dense \(shipped\), general \(shipped\), pool \(shipped\), sparse \(shipped\), mlsroad-.* or best, ",
        ),
        (
            {"model": 7, "method": "patch_graph"},
            "'7' of patch_graph is unknown; models: .*mlsroad-patch_graph version 1$",
        ),
    ],
)
def test_unknown_names_list_what_there_is(given, message):
    with pytest.raises(ParameterError, match=message):
        named_choice(**given, store=STORE)


def test_version_without_a_store_says_so():
    with pytest.raises(ParameterError, match=r"there is no MLflow store \(MLFLOW_TRACKING_URI is not set\)"):
        named_choice(model=3)


def test_facts_are_the_median_over_the_points_of_all_files():
    table = pd.DataFrame({"n_points": [10, 100, 20, 0], "median_density": [500.0, 8.0, 40.0, np.nan]})
    table["concentration"] = [0.9, 0.3, 0.2, np.nan]
    assert facts_of_quality(table) == SurveyFacts(8.0, 0.3)
    assert np.isnan(facts_of_quality(table[3:]).median_density)


def test_models_are_listed_with_their_origin():
    found = available_models(STORE)
    assert [(m.name, m.version, m.shipped) for m in found[4:]] == [
        ("mlsroad-detrended_forest", "1", False),
        ("mlsroad-detrended_forest", "2", False),
        ("mlsroad-patch_graph", "1", False),
    ]
    assert [m.name for m in found[:4]] == ["dense", "general", "pool", "sparse"]
    assert all(m.entry.scores for m in found[:4])


def test_choice_for_files_comes_from_their_points(tmp_path):
    for name, side in (("thin.txt", 20), ("thick.txt", 3)):
        xy = np.random.default_rng(0).uniform(0, side, (900, 2))
        np.savetxt(tmp_path / name, np.column_stack([xy, np.zeros(900)]), header="x y z", comments="", fmt="%.3f")
    forest = {"method": "detrended_forest"}
    assert explain_choice(str(tmp_path / "thin.txt"), **forest).model.name == "sparse"
    assert explain_choice(str(tmp_path / "thick.txt"), **forest).model.name == "dense"
    assert explain_choice(str(tmp_path / "thick.txt")).model.name == "pool"
    assert explain_choice(str(tmp_path / "thick.txt"), method="boosted_trees").model.name == "general"
    with pytest.raises(ParameterError, match="champion"):
        explain_choice(
            str(tmp_path / "thick.txt"),
            store=Store((version("patch_svm", 1, "champion"), version("patch_graph", 1, "champion"))),
        )


NEAR, FAR = [0.01, 0.02, 0.03, 0.05, 0.1], [0.1, 0.2, 0.3, 0.5, 1.0]
HIGH, LOW = [0.2, 0.25, 0.3, 0.4, 0.5], [0.0, 0.01, 0.02, 0.05, 0.1]


def planted(monkeypatch, **facts):
    """Plant a registry of shipped models with facts of their training data."""
    entry = shipped_models()["dense"]
    models = {name: replace(entry, name=name, training_facts=value) for name, value in facts.items()}
    monkeypatch.setattr(selection, "shipped_models", lambda: models)
    return models


def scenes(**facts):
    return SurveyFacts(300.0, 0.9, facts)


def test_only_shipped_model_is_taken_whatever_the_survey(monkeypatch):
    planted(monkeypatch, general={"spacing": NEAR})
    for survey in (scenes(spacing=5.0), scenes(), SPARSE):
        choice = choose(survey)
        assert (choice.model.name, choice.reason) == ("general", "it is the only shipped model")
    assert choose(SPARSE, method="detrended_forest").reason == "it is the only shipped model of detrended_forest"


@pytest.mark.parametrize(
    ("survey", "name", "counts"),
    [
        (scenes(spacing=0.4, above_5=0.03), "scans", "scans 0 .*, streets 2 "),
        (scenes(spacing=0.03, above_5=0.3), "streets", "streets 0 .*, scans 2 "),
        (scenes(spacing=0.1, above_5=0.3), "streets", "streets 0 .*, scans 1 "),
        (scenes(spacing=0.09), "streets", "streets 0 .*, scans 0 "),
        (scenes(spacing=0.12), "scans", "scans 0 .*, streets 0 "),
    ],
)
def test_of_two_models_the_one_with_the_nearest_training_data(monkeypatch, survey, name, counts):
    planted(monkeypatch, scans={"spacing": FAR, "above_5": LOW}, streets={"spacing": NEAR, "above_5": HIGH})
    choice = choose(survey)
    assert choice.model.name == name
    assert re.match(f"fewest properties of the survey are outside its training data: {counts}", choice.reason)


def test_of_three_models_those_without_facts_in_common_come_last(monkeypatch):
    planted(monkeypatch, other={"ground": HIGH}, streets={"spacing": NEAR}, scans={"spacing": FAR})
    assert choose(scenes(spacing=0.3)).model.name == "scans"


def test_few_points_are_compared_by_their_density(monkeypatch):
    planted(monkeypatch, dense={"spacing": NEAR}, sparse={"spacing": FAR})
    assert choose(SPARSE).reason == "the survey has a median of 8 points per m², below 9"


def test_properties_outside_the_training_data_of_a_listed_model(monkeypatch):
    entry = planted(monkeypatch, general={"spacing": NEAR})["general"]
    listed = AvailableModel("general", entry.method, entry.version, (), True, "streets", entry)
    assert unusual_properties_of(listed, scenes(spacing=0.9)) == [
        "points lie 0.9 m apart (median; training scenes 0.01 to 0.1 m)"
    ]
    assert unusual_properties_of(listed, scenes(spacing=0.03)) == []
    assert unusual_properties_of(replace(listed, entry=None), scenes(spacing=0.9)) == []

"""Runs of the benchmark and their training data."""

import dataclasses

import pytest
from helpers.conf import base

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.models.methods import METHODS, methods_of
from mlsroad_pipeline.papers.comparison.recordings.parameters import PROTOCOLS, SHIPPED, StudyParameters, sources_of
from mlsroad_pipeline.papers.comparison.recordings.plan import Run, StudyPlan, model_key
from mlsroad_pipeline.papers.comparison.recordings.preparation import preparation_of

FIELDS = {"title": "T", "coding": "oakland", "classes": ["ground"], "scanner": "s", "licence": "l"}
TOY = {
    "first": {**FIELDS, "files": "first/*.npz", "group": "drive", "test": {"azimuth": 0, "offset": 0}},
    "second": {**FIELDS, "files": "second/*.npz", "group": "drive", "test": {"azimuth": 0, "offset": 0}},
    "blocks": {**FIELDS, "files": "blocks/*.npz", "test": {"files": ["b*.npz"]}},
}


@pytest.fixture
def plan(tmp_path):
    for name, stems in {"first": range(10), "second": range(2), "blocks": ["a1", "a2", "b1"]}.items():
        (tmp_path / name).mkdir()
        for stem in stems:
            (tmp_path / name / f"{stem}.npz").touch()

    def make(**changes):
        values = {**base("recordings_study"), "root": str(tmp_path), "sources": TOY, "streets": {"s": {}, "off": None}}
        scheme = ClassScheme.from_config("common", base("classes")["schemes"]["common"])
        study = StudyParameters(**{**values, "scenes_per_source": 4, **changes})
        return StudyPlan(study, sources_of(TOY), {}, scheme, {})

    return make


def test_every_labeller_that_needs_no_images_is_run_on_every_recording_by_every_protocol(plan):
    runs = plan().runs()
    trained = len(methods_of("labelling")) * len(TOY) * (len(PROTOCOLS) - 1)
    assert len(set(runs)) == len(runs) == trained + (len(PROTOCOLS) + 1) * len(TOY)
    assert {run.method for run in runs if run.protocol == SHIPPED} == {"general", "pool"}
    assert all(preparation_of(slug).kind for slug in methods_of("labelling"))
    assert all(not METHODS[run.trained].needs_images for run in runs if run.protocol != SHIPPED)
    assert {run.protocol for run in runs if run.method == "pool"} == set(PROTOCOLS)
    assert [Run.parse(run.key) for run in runs] == runs


def test_recordings_that_the_network_learned_from_have_the_shipped_pool_alone(plan):
    runs = plan(seen=["first"]).runs()
    assert {run.protocol for run in runs if (run.method, run.source) == ("pool", "first")} == {SHIPPED}
    assert {run.protocol for run in runs if (run.method, run.source) == ("pool", "second")} == set(PROTOCOLS)
    assert len(runs) == len(plan().runs()) - (len(PROTOCOLS) - 1)


def test_one_method_recording_and_protocol_can_be_asked_for(plan):
    chosen = plan(method="patch_svm", source="blocks", protocol="own")
    assert chosen.runs() == [Run("patch_svm", "own", "blocks")]
    assert chosen.read_sources() == ["blocks"]
    with pytest.raises(ParameterError, match="source 'third' is none of first, second, blocks"):
        plan(source="third").runs()
    with pytest.raises(ParameterError, match="protocol 'all' is none of shipped"):
        plan(protocol="all")
    with pytest.raises(ParameterError, match="method 'patch_svm' has no protocol 'shipped'"):
        plan(method="patch_svm", protocol="shipped").runs()


def test_a_left_out_recording_takes_its_drive_with_it(plan):
    for name in ("first", "second"):
        scenes = plan().training_scenes(Run("patch_svm", "others", name))
        assert scenes == dict.fromkeys(["street.s", "blocks.a1", "blocks.a2", "blocks.b1"], "whole")
    assert model_key(plan(), Run("patch_svm", "others", "first")) == model_key(
        plan(), Run("patch_svm", "others", "second")
    )


def test_own_training_part_has_no_test_block_and_evenly_spread_scans(plan):
    assert plan().training_scenes(Run("patch_svm", "own", "blocks")) == {"blocks.a1": "own", "blocks.a2": "own"}
    scans = plan().training_scenes(Run("patch_svm", "own_and_simulated", "first"))
    assert scans == {"street.s": "whole", **dict.fromkeys(["first.0", "first.3", "first.6", "first.9"], "own")}


def test_simulated_streets_alone_are_one_model_for_all_recordings(plan):
    keys = {model_key(plan(), Run("patch_svm", "simulated", name)) for name in TOY}
    assert keys == {"patch_svm.simulated"}
    assert plan().training_scenes(Run("patch_svm", "simulated", "first")) == {"street.s": "whole"}


def test_models_of_different_training_data_have_different_keys(plan):
    study, by_key = plan(), {}
    for run in study.trained_runs():
        by_key.setdefault(model_key(study, run), []).append(study.training_scenes(run))
    for scenes in by_key.values():
        assert all(other == scenes[0] for other in scenes)
    distinct = {(key.partition(".")[0], tuple(sorted(scenes[0].items()))) for key, scenes in by_key.items()}
    assert len(distinct) == len(by_key)


def test_the_pool_has_the_trees_of_its_protocol(plan):
    for run in plan(method="pool").trained_runs():
        trees = Run("boosted_trees", run.protocol, run.source)
        assert model_key(plan(), run) == model_key(plan(), trees)
        assert plan().training_scenes(run) == plan().training_scenes(trees)


def test_a_model_depends_on_the_parameters_of_the_stages_its_own_and_those_that_it_refines(plan):
    names = ("features", "patch_graph", "patch_graph_mrf", "patch_svm")
    known = dataclasses.replace(plan(), parameters=dict.fromkeys(names, 1))
    assert set(known.parameters_of("patch_graph_mrf")) == {"features", "patch_graph", "patch_graph_mrf"}
    assert set(known.parameters_of("patch_graph")) == {"features", "patch_graph"}
    assert set(known.parameters_of("patch_svm")) == {"features", "patch_svm"}

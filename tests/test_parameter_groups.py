"""Groups of parameters: every file of conf/base is a dataclass of the code, with its fields and defaults."""

import ast
import dataclasses
import inspect
import re

import pytest
from helpers.conf import CONF, base, base_groups
from helpers.yaml_files import read_yaml
from numpydoc.docscrape import ClassDoc

from mlsroad_pipeline.algorithms.core.stage_parameters import FeatureParameters, GroundParameters, SupervoxelParameters
from mlsroad_pipeline.algorithms.models.methods import trained_methods
from mlsroad_pipeline.algorithms.models.pool.log_linear import PoolParameters
from mlsroad_pipeline.algorithms.scenes.parameters import IngestParameters, OutlierParameters
from mlsroad_pipeline.algorithms.segmentation.normalized_cut import NormalizedCutParameters
from mlsroad_pipeline.algorithms.segmentation.stage import SegmentationParameters
from mlsroad_pipeline.algorithms.segmentation.two_step import TwoStepParameters
from mlsroad_pipeline.algorithms.segmentation.yang_dong import YangDongParameters
from mlsroad_pipeline.label.object_scoring import ScoreParameters
from mlsroad_pipeline.model_store.shipped_entry import ShippedParameters
from mlsroad_pipeline.papers.comparison.recordings.parameters import StudyParameters as RecordingsStudyParameters
from mlsroad_pipeline.papers.luo2016.study.plan import StudyParameters
from mlsroad_pipeline.papers.luo2019.study.plan import StudyParameters as Luo2019StudyParameters
from mlsroad_pipeline.papers.luo2019.study.sets import SimulatedObjectsParameters
from mlsroad_pipeline.papers.shared.detection.scoring import DetectionParameters
from mlsroad_pipeline.papers.shared.patches.extraction import PatchParameters
from mlsroad_pipeline.papers.shared.recognition.cutting import RecognitionParameters
from mlsroad_pipeline.papers.tomic2019.image_labels.training_parameters import TrainingParameters
from mlsroad_pipeline.papers.tomic2019.study.plan import StudyParameters as Tomic2019StudyParameters
from mlsroad_pipeline.papers.yu2016.study.parameters import StudyParameters as Yu2016StudyParameters
from mlsroad_pipeline.surveys.inspection import InspectParameters
from mlsroad_pipeline.surveys.parameters import LabelParameters, SurveyParameters

TYPED = {
    **{method.group or slug: method.load("parameters") for slug, method in trained_methods().items()},
    "detection": DetectionParameters,
    "segmentation": SegmentationParameters,
    "recognition": RecognitionParameters,
    "features": FeatureParameters,
    "ground_removal": GroundParameters,
    "ingest": IngestParameters,
    "inspect": InspectParameters,
    "score": ScoreParameters,
    "label": LabelParameters,
    "luo2016_study": StudyParameters,
    "luo2019_study": Luo2019StudyParameters,
    "recordings_study": RecordingsStudyParameters,
    "simulated_objects": SimulatedObjectsParameters,
    "tomic2019_study": Tomic2019StudyParameters,
    "yu2016_study": Yu2016StudyParameters,
    "patches": PatchParameters,
    "shipped": ShippedParameters,
    "supervoxelise": SupervoxelParameters,
    "survey": SurveyParameters,
}
CONFIGURED = {
    "jointnet_printed", "jointnet_tuned", "luo2016_study", "luo2019_study", "patch_graph_mrf_printed",
    "patch_graph_printed", "recordings_study", "simulated_objects", "survey", "tomic2019_study", "visual_words_printed",
    "yu2016_study",
}  # fmt: skip
"""Groups whose values are those of the embedded survey or of a paper and not the defaults of the code."""
DIFFERENCES_ONLY = {"plain_cut": NormalizedCutParameters, "printed_cut": NormalizedCutParameters}
"""Nested groups of which the configuration sets only values that differ from the defaults of their dataclass."""
TREES = {"classes", "simulation"}
"""Groups parsed by separate functions."""


def default_of(field):
    if field.default is not dataclasses.MISSING:
        return field.default
    if field.default_factory is not dataclasses.MISSING:
        made = field.default_factory()
        return dataclasses.asdict(made) if dataclasses.is_dataclass(made) else made
    return dataclasses.MISSING


def test_every_group_of_parameters_is_known_here():
    assert set(base_groups()) == set(TYPED) | TREES


@pytest.mark.parametrize("group", TYPED)
def test_keys_are_the_fields_of_the_dataclass(group):
    assert list(base(group)) == [field.name for field in dataclasses.fields(TYPED[group])] or set(base(group)) == {
        field.name for field in dataclasses.fields(TYPED[group])
    }


def as_yaml(value):
    """Turn tuples into lists, also nested ones: YAML has lists only."""
    if isinstance(value, (list, tuple)):
        return [as_yaml(entry) for entry in value]
    return {key: as_yaml(entry) for key, entry in value.items()} if isinstance(value, dict) else value


@pytest.mark.parametrize("group", sorted(set(TYPED) - CONFIGURED))
def test_values_are_the_defaults_of_the_code(group):
    for field in dataclasses.fields(TYPED[group]):
        default, configured = default_of(field), base(group)[field.name]
        if field.name in DIFFERENCES_ONLY:
            configured = as_yaml(dataclasses.asdict(DIFFERENCES_ONLY[field.name](**configured)))
        if default is not dataclasses.MISSING:
            assert configured == as_yaml(default), field.name


@pytest.mark.parametrize(
    "kind",
    [
        *TYPED.values(),
        NormalizedCutParameters,
        OutlierParameters,
        PoolParameters,
        TrainingParameters,
        TwoStepParameters,
        YangDongParameters,
    ],
    ids=lambda kind: kind.__name__,
)
def test_documented_defaults_are_the_defaults_of_the_code(kind):
    fields = {field.name: default_of(field) for field in dataclasses.fields(kind)}
    documented = {name: entry.type for entry in ClassDoc(kind)["Parameters"] for name in entry.name.split(", ")}
    if not documented:  # each field has a comment instead, on its line or above it
        source = "".join(inspect.getsource(base) for base in kind.__mro__ if dataclasses.is_dataclass(base))
        commented = re.findall(r"^    (?:# .*\n    (\w+): |(\w+): .*  # \S)", source, re.M)
        assert {above or beside for above, beside in commented} == set(fields)
    else:
        assert set(documented) == set(fields)
    for name, text in documented.items():
        told = re.search(r"default (.+)$", text)
        if told:
            assert ast.literal_eval(told[1]) == fields[name], name
        elif "optional" in text:
            none_or_said_in_words = (
                "evaluation_scheme", "folds", "magnification", "masks", "method", "model", "protocol", "source", "sydney",
                "trajectory", "weights", "window",
            )  # fmt: skip
            assert name in none_or_said_in_words, name
        else:
            assert fields[name] is dataclasses.MISSING or isinstance(fields[name], dict), name


def leaves(tree, path=()):
    for key, value in tree.items():
        if isinstance(value, dict):
            yield from leaves(value, (*path, key))
        else:
            yield (*path, key), value


@pytest.mark.parametrize("name", ["quick", "tiny"])
def test_smaller_scales_change_parameters_that_there_are(name):
    configured = read_yaml(CONF / f"{name}.yml")
    changes = configured["run"]["params"] if name == "quick" else configured
    for path, value in leaves(changes):
        there = base(path[0])
        for key in path[1:]:
            known = isinstance(there, dict) and key in there
            assert known or "surveys" in path, path  # a survey takes any parameter of the simulator
            there = there[key] if known else None
        assert name == "tiny" or value != there, (path, "is the base's own")

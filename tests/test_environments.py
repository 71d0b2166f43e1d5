"""Environments of recordings that are not at hand: generated files in their formats are read correctly."""

import dataclasses

import numpy as np
import pytest
from helpers.wiring import make_project, session_of

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY
from mlsroad_pipeline.algorithms.core.exceptions import ReadError
from mlsroad_pipeline.formats.registry import get_format
from mlsroad_pipeline.surveys.plan import plan_comparison

CODES = np.array([0, 1, 2, 4, 7, 9, 10, 14, 15, 19, 20, 21, 22, 23, 24, 25, 26], np.int32)


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    return make_project(tmp_path_factory.mktemp("environments"), tiny=False)


def parameters_of(project, env, root):
    with session_of(project, env=env, survey={"root": str(root)}) as session:
        return session.load_context().params


def write_rue_madame(path):
    """Write a file in the format of Paris-Rue-Madame: binary PLY with x, y, z, reflectance, label and class."""
    rows = np.zeros(
        len(CODES), [(name, "<f4") for name in ("x", "y", "z", "reflectance")] + [("label", "<i4"), ("class", "<i4")]
    )
    rows["x"], rows["reflectance"] = np.arange(len(CODES)), 0.5
    rows["label"], rows["class"] = np.arange(len(CODES)) + 100, CODES
    kinds = ["float"] * 4 + ["int"] * 2
    properties = "".join(f"property {kind} {name}\n" for kind, name in zip(kinds, rows.dtype.names, strict=True))
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(rows)}\n{properties}end_header\n"
    path.write_bytes(head.encode() + rows.tobytes())


def test_rue_madame_is_read_with_classes_and_objects(project, tmp_path):
    (tmp_path / "rueMadame_database").mkdir()
    for name in ("GT_Madame1_2.ply", "GT_Madame1_3.ply"):
        write_rue_madame(tmp_path / "rueMadame_database" / name)
    parameters = parameters_of(project, "rue_madame", tmp_path)
    plan = plan_comparison(parameters["survey"], parameters["ingest"], parameters["classes"]["codings"])
    assert [(file.split, file.source.name[-16:]) for file in plan.files] == [
        ("train", "GT_Madame1_2.ply"),
        ("test", "GT_Madame1_3.ply"),
    ]
    path = plan.files[0].source.path
    cloud = get_format(path).read(path, plan.options)
    assert cloud["instance"].tolist() == list(range(100, 100 + len(CODES)))
    assert (cloud["intensity"] == 0.5).all()
    found = dict(zip(CODES.tolist(), cloud["label"].tolist(), strict=True))
    names = {4: "car", 7: "light_pole", 10: "motorcycle", 14: "traffic_sign", 22: "person", 0: "unlabelled"}
    assert {code: found[code] for code in names} == {code: TAXONOMY[name] for code, name in names.items()}


def test_methods_of_the_environment_printed_have_the_values_of_the_variants_as_printed(project):
    with session_of(project, env="printed") as session:
        context = session.load_context()
        parameters, catalog = context.params, context.catalog
    for name in ("patch_graph", "patch_graph_mrf", "visual_words", "jointnet"):
        assert parameters[name] == parameters[f"{name}_printed"], name
        assert str(catalog.get(f"{name}.scores")._filepath).endswith(f"data/08_reporting/printed/scores/{name}.csv")
    assert parameters["segmentation"].method == "normalized_cut_printed"


@pytest.mark.parametrize("env", ["rue_madame", "oakland", "semantickitti"])
def test_absent_recording_says_where_it_is_to_be_had(project, tmp_path, env):
    parameters = parameters_of(project, env, tmp_path / "absent")
    survey = parameters["survey"]
    with pytest.raises(
        ReadError, match=r"absent is not a folder \(survey.root\); the data are available from https://"
    ):
        plan_comparison(survey, parameters["ingest"], parameters["classes"]["codings"])
    with pytest.raises(ReadError, match=r"absent is not a folder \(survey.root\)$"):
        dataclasses.replace(survey, source=None).check_root()

"""Environments of recordings that are not at hand: generated files in their formats are read correctly."""

import dataclasses
import os

import numpy as np
import pytest
from helpers.wiring import make_project, session_of

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY, find_scheme
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


KINDS = {"<f4": "float", "<f8": "double", "u1": "uchar", "<i4": "int"}


def write_ply(path, properties, codes, coded, **values):
    """Write a binary PLY with a point per code in the property `coded`; other properties are 0."""
    rows = np.zeros(len(codes), properties)
    rows["x"], rows[coded] = np.arange(len(codes)), codes
    for name, value in values.items():
        rows[name] = value
    lines = "".join(f"property {KINDS[kind]} {name}\n" for name, kind in properties)
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(rows)}\n{lines}end_header\n"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(head.encode() + rows.tobytes())


def write_rue_madame(path):
    """Write a file in the format of Paris-Rue-Madame: binary PLY with x, y, z, reflectance, label and class."""
    properties = [(name, "<f4") for name in ("x", "y", "z", "reflectance")] + [("label", "<i4"), ("class", "<i4")]
    write_ply(path, properties, CODES, "class", reflectance=0.5, label=np.arange(len(CODES)) + 100)


XYZ = [(axis, "<f4") for axis in "xyz"]
COLOURS = [(name, "u1") for name in ("red", "green", "blue")]
RECORDINGS = {  # environment: properties, property of the class, files of train and test, classes of some codes
    "toronto3d": (
        [(axis, "<f8") for axis in "xyz"] + COLOURS
        + [(f"scalar_{name}", "<f4") for name in ("Intensity", "GPSTime", "ScanAngleRank", "Label")],
        "scalar_Label", ["L001.ply", "L003.ply", "L004.ply"], ["L002.ply"],
        {2: "lane_marking", 3: "other_vegetation", 5: "wire", 8: "fence"},
    ),
    "paris_lille": (
        [*XYZ, ("reflectance", "<f4"), ("class", "<i4")], "class",
        ["Lille1_1.ply", "Lille1_2.ply", "Paris.ply"], ["Lille2.ply"],
        {1: "other_ground", 4: "bollard", 7: "person", 9: "other_vegetation"},
    ),
    "kitti360": (
        [*XYZ, *COLOURS, ("semantic", "<i4"), ("instance", "<i4"), ("visible", "u1"), ("confidence", "<f4")], "semantic",
        ["2013_05_28_drive_0000_sync/static/0000000002_0000000385.ply"],
        ["2013_05_28_drive_0009_sync/static/0000000002_0000000292.ply"],
        {7: "road", 17: "post", 20: "traffic_sign", 26: "car", 44: "unlabelled"},
    ),
    "tum_mls": (
        [*XYZ, ("label", "<i4")], "label", ["area1.ply", "area2.ply"], ["area3.ply"],
        {1: "road", 4: "brushwood", 7: "other_object"},
    ),
    "whu_urban3d": (
        None, "semantics", ["0404.npz", "2002.npz"], ["2323.npz", "8038.npz"],
        {100901: "hydrant", 103500: "post", 105400: "other_object", 200000: "bridge"},
    ),
}  # fmt: skip


def write_npz(path, codes):
    """Write a scene of WHU-Urban3D with a point per code, with the arrays and types of its HDF5 files."""
    path.parent.mkdir(parents=True, exist_ok=True)
    coords = np.zeros((len(codes), 3), np.float32)
    coords[:, 0] = np.arange(len(codes))
    intensity, semantics = np.arange(len(codes), dtype=np.float32), np.array(codes, np.int64)
    np.savez(path, coords=coords, intensity=intensity, semantics=semantics, instances=semantics)


@pytest.mark.parametrize("env", RECORDINGS)
def test_recordings_that_are_not_at_hand_are_read_with_their_classes(project, tmp_path, env):
    properties, label, train, test, names = RECORDINGS[env]
    parameters = parameters_of(project, env, tmp_path)
    codes = sorted(parameters["classes"]["codings"][env])
    for name in (*train, *test):
        path = tmp_path / "folder" / name
        write_ply(path, properties, codes, label) if properties else write_npz(path, codes)
    plan = plan_comparison(parameters["survey"], parameters["ingest"], parameters["classes"]["codings"])
    wanted = [*(("train", name) for name in train), *(("test", name) for name in test)]
    assert [(file.split, os.path.relpath(file.source.path, tmp_path / "folder")) for file in plan.files] == wanted
    path = plan.files[0].source.path
    cloud = get_format(path).read(path, plan.options)
    assert "intensity" in cloud or env in ("kitti360", "tum_mls")
    found = dict(zip(codes, cloud["label"].tolist(), strict=True))
    assert {code: found[code] for code in names} == {code: TAXONOMY[name] for code, name in names.items()}
    scheme = find_scheme(parameters["classes"]["schemes"], parameters["survey"].scheme)
    encoded = scheme.encode(cloud["label"], source=str(path))
    assert set(encoded[encoded >= 0]) <= set(range(len(scheme))) and (encoded >= 0).sum() >= len(codes) // 2


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


@pytest.mark.parametrize("env", ["rue_madame", "oakland", "semantickitti", *RECORDINGS])
def test_absent_recording_says_where_it_is_to_be_had(project, tmp_path, env):
    parameters = parameters_of(project, env, tmp_path / "absent")
    survey = parameters["survey"]
    with pytest.raises(
        ReadError, match=r"absent is not a folder \(survey.root\); the data are available from https://"
    ):
        plan_comparison(survey, parameters["ingest"], parameters["classes"]["codings"])
    with pytest.raises(ReadError, match=r"absent is not a folder \(survey.root\)$"):
        dataclasses.replace(survey, source=None).check_root()

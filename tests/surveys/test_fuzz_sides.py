"""Damaged files beside the points: values, or one line that names the file.

``MLSROAD_FUZZ=1000`` sets the number of mutated files per kind; the suite runs a sample of them.
"""

import functools
import json
import os

import numpy as np
import pytest
from helpers.mutations import mutated, mutated_json, mutated_table, mutated_value, refusals
from PIL import Image

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.core.codings import Coding
from mlsroad_pipeline.algorithms.core.exceptions import MlsRoadError
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.formats.crs import sidecar_crs
from mlsroad_pipeline.label.checks import check_device
from mlsroad_pipeline.label.inventory import read_sections
from mlsroad_pipeline.model_store.bundle_files import load_bundle, save_bundle
from mlsroad_pipeline.surveys.camera_files import read_images, read_poses
from mlsroad_pipeline.surveys.trajectory_files import read_trajectory
from mlsroad_pipeline.surveys.truth_tables import read_truth

N_CASES = int(os.environ.get("MLSROAD_FUZZ", "50"))

VIEW = {
    "K": [[500, 0, 320], [0, 500, 240], [0, 0, 1]],
    "distortion": [0.1, 0, 0, 0, 0],
    **{"R": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "t": [0, 0, 0], "width": 640, "height": 480},
}
PLACES = [{"name": "a", "camera": "front", "gps_time": 1.0}, {"name": "b", "camera": "front", "gps_time": 1.5}]
CAMERAS = {"origin": [0, 0, 0], "images": [{**place, **VIEW} for place in PLACES]}
MOUNTED = {"cameras": {"front": VIEW}, "images": PLACES}
ROWS = "name,camera,gps_time,fx,fy,cx,cy,width,height,k1,{0}x,{0}y,{0}z,{0}qw,{0}qx,{0}qy,{0}qz\n"
ROWS += "a,front,1.0,500,500,320,240,640,480,0.1,1,2,3,1,0,0,0\nb,front,1.5,500,500,320,240,640,480,0.1,1,2,3,1,0,0,0\n"
POSES = "gps_time,x,y,z,roll,pitch,heading\n" + "".join(f"{i / 2},{i},0,2,0,0,0\n" for i in range(12))
TURNED = "gps_time,x,y,z,qw,qx,qy,qz\n" + "".join(f"{i / 2},{i},0,2,1,0,0,0\n" for i in range(12))
PATH = "time,x,y,z\n" + "".join(f"{i / 2},{i},0,2\n" for i in range(40))
SBET = np.zeros((40, 17))
SBET[:, :4] = np.column_stack([1e5 + np.arange(40) / 10, 0.85 + np.arange(40) * 1e-7, [0.15] * 40, [100] * 40])
CALIB = "".join(f"P{i}: 700 0 300 0 0 700 100 0 0 0 1 0\n" for i in range(4))
CALIB += "Tr: 0 -1 0 0 0 0 -1 0 1 0 0 0\nTr_velo_to_cam: 0 -1 0 0 0 0 -1 0 1 0 0 0\nR0_rect: 1 0 0 0 1 0 0 0 1\n"
TRUTH = "kind,x,y,height,counted\ntree,1,2,3,true\npole,4,5,6,false\n"
PANDASET = "label,yaw,stationary,position.x,position.y,position.z,dimensions.x,dimensions.y,dimensions.z,"
PANDASET += "cuboids.sibling_id,cuboids.sensor_id\nCar,0.1,True,1,2,3,2,4,2,-,-1\nCar,0.1,True,1,2,3,2,4,2,a,1\n"
SIMULATED = "instance,label,design,x,y,z,heading,length,width,height,box_x,box_y,panel_x,panel_y,panel_azimuth,moving\n"
SIMULATED += "1,31,tree,1,2,0,0,1,1,1,1,2,,,,False\n2,42,sign,1,2,0,0,1,1,1,1,2,1,2,0.1,True\n"
KITTI = "Car 0.00 0 -1.5 100 100 200 200 1.5 1.6 4.0 1 1 10 0.1\n"
KITTI += "DontCare -1 -1 -10 100 100 200 200 -1 -1 -1 -1000 -1000 -1000 -10\n"
SECTIONS = "section,from_station,to_station\nA,0,100\nB,100,250\n"
SCHEME = {"name": "two", "classes": ["road", "tree"], "members": [["road"], ["tree"]], "ignored": [], "asprs": [2, 5]}
WKT = 'LOCAL_CS["a",UNIT["metre",1]]'


def kitti_sequence(folder):
    (folder / "image_2").mkdir()
    Image.new("RGB", (640, 480)).save(folder / "image_2" / "000000.png")
    (folder / "calib.txt").write_text(CALIB)
    (folder / "poses.txt").write_text("1 0 0 0 0 1 0 0 0 0 1 0\n")
    (folder / "times.txt").write_text("0.5\n")


def kitti_labels(folder):
    for name, text in (("calib", CALIB), ("label_2", KITTI)):
        (folder / name).mkdir()
        (folder / name / "0.txt").write_text(text)


def model(folder):
    metadata = {"classes": ["a", "b"], "scheme": SCHEME, "segmentation": {"source": "network"}}
    metadata["parameters"] = {"device": "auto", "recogniser": {"training": {"device": "cpu"}}}
    metadata["members"] = {"image_labels": {"parameters": {"device": "cpu"}}}
    save_bundle(ModelBundle("toy", {"a": np.arange(5.0)}, metadata), folder)


def read_model(path):
    check_device(load_bundle(path.parent))


@pytest.mark.parametrize(
    "place",
    [
        "parameters",
        "parameters.recogniser",
        "parameters.recogniser.training",
        "segmentation",
        "members",
        "members.image_labels",
    ],
)
def test_parts_of_a_model_that_are_no_mappings_are_named(tmp_path, place):
    model(tmp_path)
    content = json.loads((tmp_path / "model.json").read_text())
    *outer, last = place.split(".")
    parent = content["metadata"]
    for key in outer:
        parent = parent[key]
    parent[last] = None
    (tmp_path / "model.json").write_text(json.dumps(content))
    with pytest.raises(MlsRoadError, match=rf"model\.json: metadata\.{place} is null, not a mapping: .* damaged"):
        load_bundle(tmp_path)


def read_with_poses(path):
    (path.parent / "p.csv").write_text(POSES)
    return read_images(path, trajectory=path.parent / "p.csv")


def in_folder(reader):
    return lambda path: reader(path.parent)


KINDS = {  # name of the damaged file, content or function that makes its folder, damage, reader
    "cameras_json": ("c.json", json.dumps(CAMERAS), mutated_json, read_images),
    "mounted_json": ("c.json", json.dumps(MOUNTED), mutated_json, read_with_poses),
    "cameras_csv": ("c.csv", ROWS.format(""), mutated_table, read_images),
    "mounted_csv": ("c.csv", ROWS.format("mount_"), mutated_table, read_with_poses),
    "poses": ("p.csv", POSES, mutated_table, read_poses),
    "quaternions": ("p.csv", TURNED, mutated_table, read_poses),
    "trajectory": ("t.csv", PATH, mutated_table, read_trajectory),
    "sbet": ("t.sbet", SBET.tobytes(), mutated, functools.partial(read_trajectory, crs="EPSG:25832")),
    "kitti_calibration": ("calib.txt", kitti_sequence, mutated_table, in_folder(read_images)),
    "kitti_poses": ("poses.txt", kitti_sequence, mutated_table, in_folder(read_images)),
    "kitti_times": ("times.txt", kitti_sequence, mutated_table, in_folder(read_images)),
    "kitti_labels": ("label_2/0.txt", kitti_labels, mutated_table, read_truth),
    "truth": ("t.csv", TRUTH, mutated_table, read_truth),
    "pandaset": ("t.csv", PANDASET, mutated_table, read_truth),
    "simulated": ("t.csv", SIMULATED, mutated_table, read_truth),
    "sections": ("s.csv", SECTIONS, mutated_table, read_sections),
    "model": ("model.json", model, mutated_json, read_model),
    "arrays": ("arrays.npz", model, mutated, in_folder(load_bundle)),
    "prj": ("s.prj", WKT, mutated, lambda path: sidecar_crs(path.with_suffix(".xyz"))),
}
COSTS = {"prj": 1, **dict.fromkeys(("model", "arrays", "cameras_json"), 60)}
"""Tenths of `N_CASES` of kinds that take much more or less time than the others."""


@pytest.mark.parametrize("kind", KINDS)
def test_damaged_files_beside_the_points(tmp_path, kind):
    name, content, damage, reader = KINDS[kind]
    path = tmp_path / name
    if callable(content):
        content(tmp_path)
    else:
        path.write_bytes(content.encode() if isinstance(content, str) else content)
    refused = refusals(path, damage, reader, N_CASES * COSTS.get(kind, 10) // 10)
    assert refused > N_CASES // 20 or kind == "prj"  # the damage is damage; a .prj that is none is logged


@pytest.mark.parametrize("what", ["scheme", "coding"])
def test_damaged_class_schemes(what):
    config = {
        "classes": {"road": {"members": ["road"], "asprs": 2}, "tree": {"members": ["tree"], "asprs": 5}},
        "ignore": ["noise"],
    }
    codes = {"1": "road", "2": "tree"}
    for case in range(6 * N_CASES):
        rng = np.random.default_rng(case)
        try:
            if what == "scheme":
                ClassScheme.from_config("mine", mutated_value(config, rng))
            else:
                Coding.from_config("mine", mutated_value(codes, rng))
        except MlsRoadError as error:
            assert "mine" in str(error) and len(str(error).splitlines()) == 1
        except Exception as error:
            raise AssertionError(f"{what}, case {case}: {type(error).__name__}: {error}") from error


def test_values_are_named(tmp_path):
    for place, value, message in (
        (("images", 0, "K", 0, 0), "wide", "K must be numbers of shape"),
        (("images", 1, "width"), None, "width must be an integer"),
        (("images", 1, "gps_time"), "noon", "gps_time is 'noon', not a number"),
        (("origin",), [0, "x", 0], "origin is"),
        (("images", 0), 7, "image 0 is 7"),
        (("cameras",), [1], "cameras is"),
    ):
        document = json.loads(json.dumps(CAMERAS))
        parent = document
        for key in place[:-1]:
            parent = parent[key]
        parent[place[-1]] = value
        (tmp_path / "c.json").write_text(json.dumps(document))
        with pytest.raises(MlsRoadError, match=rf"c\.json: .*{message}"):
            read_images(tmp_path / "c.json")

"""Single pipelines on a handful of points: how a survey is planned, cut and looked at, and what each stage hands on."""

import shutil

import numpy as np
import pandas as pd
import pytest
from helpers.wiring import TINY, joined, make_project, run, session_of
from kedro.framework.project import pipelines

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.formats.base import WriteOptions
from mlsroad_pipeline.formats.las.format import LasFormat
from mlsroad_pipeline.pipelines.composition import comparison

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]

ORIGIN = np.array([389_300.0, 5_819_700.0, 34.0])
CONTRACT = {
    *("simulate", "ingest", "ground_removal", "supervoxelise", "features", "patches", "detrended_forest"),
    *(
        "patch_svm",
        "patch_forest",
        "patch_graph",
        "patch_graph_mrf",
        "patch_graph_printed",
        "patch_graph_mrf_printed",
        "max_margin_markov",
        "shape_based",
        "superpoint_transformer",
        "boosted_trees",
        "segmentation",
        "visual_words",
        "hough_forest",
        "object_matching",
        "bottom_up_top_down",
        "evaluation",
        "report",
        "label",
        "inspect",
        "compare",
        "image_labels",
        "fusion",
        "tomic2019_study",
        "recognition",
        "all_methods",
        "comparison_report",
    ),
}


@pytest.fixture
def project(tmp_path):
    folder = tmp_path / "project"
    folder.mkdir()
    return make_project(folder)


def write(path, xyz, *, seconds=10.0, **columns):
    """Write points in the order of their x, one after the other in time."""
    path.parent.mkdir(parents=True, exist_ok=True)
    xyz = np.asarray(xyz, dtype=np.float64)
    time = np.interp(xyz[:, 0], [xyz[:, 0].min(), xyz[:, 0].max() + 1e-9], [0.0, seconds])
    cloud = PointCloud(xyz, {"gps_time": time, **columns}, ORIGIN)
    LasFormat().write(path, cloud, WriteOptions(like="none"))
    return path


def road(rng, low, high, n=3000):
    xyz = np.column_stack([rng.uniform(low, high, n), rng.uniform(-4, 4, n), rng.normal(0, 0.01, n)])
    return np.round(xyz[np.argsort(xyz[:, 0])], 3)


def given(tmp_path, **changes):
    fixed = {"simulation": {"enabled": False}, "survey": {"root": str(tmp_path / "survey")}}
    return joined(TINY, fixed, changes)


def loaded(project, name, **parameters):
    with session_of(project, **parameters) as session:
        found = session.load_context().catalog.load(name)
        return {key: handle.load() for key, handle in found.items()} if hasattr(found, "part") else found


def labels(n, name="road"):
    return np.full(n, TAXONOMY[name], dtype=np.uint8)


def names_of(*parts):
    """Return the names of the nodes of pipelines, without their namespaces."""
    return {node.name.rpartition(".")[2] for name in parts for node in pipelines[name].nodes}


def test_registry_has_the_pipelines_of_the_contract(project):
    with session_of(project):
        names = {name for name in pipelines if pipelines[name]}
    assert CONTRACT | {"__default__"} <= names
    assert names_of("__default__") == names_of(*comparison())
    every = names_of(*comparison(), "recognition", "image_labels", "fusion")
    assert names_of("all_methods") == every | {"compare_image_methods"}


def test_every_free_input_of_a_pipeline_is_stored_by_another_or_is_a_parameter(project):
    with session_of(project):
        made = {output for name in CONTRACT for output in pipelines[name].all_outputs()}
        for name in CONTRACT:
            unmade = {entry for entry in pipelines[name].inputs() if not entry.startswith("params:")} - made
            unmade = {entry for entry in unmade if not entry.endswith(".checkpoints")}  # filled by the training itself
            assert unmade <= {"label_run", "stage_costs"}, name
            assert len({node.name for node in pipelines[name].nodes}) == len(pipelines[name].nodes)


def test_simulate_writes_nothing_where_the_environment_brings_its_own_survey(project, tmp_path):
    run(project, "simulate", **given(tmp_path))
    assert not (tmp_path / "survey").exists() and not (project / "data/01_raw").exists()


def test_ingest_joins_the_files_of_a_folder_and_cuts_them_along_the_main_axis(project, tmp_path, rng):
    parts = {"a.laz": road(rng, 0, 20), "b.laz": road(rng, 15, 40)}
    for name, xyz in parts.items():
        write(tmp_path / "survey/train" / name, xyz, label=labels(len(xyz)))
    write(tmp_path / "survey/test/c.laz", parts["a.laz"], label=labels(3000))
    parameters = given(tmp_path, ingest={"scene_length": 10.0, "buffer": 2.0, "bin_length": 1.0})
    run(project, "ingest", **parameters)
    scenes = {k: s for k, s in loaded(project, "scenes", **parameters).items() if k.startswith("train.")}
    assert 4 <= len(scenes) <= 5
    seen = []
    for scene in scenes.values():
        world = scene.world_xyz() - ORIGIN
        core = world[scene["core"]]
        assert np.ptp(core[:, 0]) < 10.6 and np.ptp(world[:, 0]) < 14.7  # the axis is the road's up to a few degrees
        files, rows = scene["file"], scene["row"]
        for number, name in enumerate(parts):
            mine = files == number
            assert np.abs(world[mine] - parts[name][rows[mine]]).max(initial=0.0) < 2e-3
        seen.append(np.column_stack([files, rows])[scene["core"]])
    seen = np.concatenate(seen)
    assert len(np.unique(seen, axis=0)) == len(seen) == 6000  # each point in one core
    assert all("a.laz" in s.source or "b.laz" in s.source for s in scenes.values())


def test_ingest_by_file_makes_each_file_a_scene_without_buffers(project, tmp_path, rng):
    for name in ("train/a", "train/b", "test/c"):
        write(tmp_path / "survey" / f"{name}.laz", road(rng, 0, 40), label=labels(3000))
    parameters = given(tmp_path, ingest={"cut": "file"})
    run(project, "ingest", **parameters)
    scenes = loaded(project, "scenes", **parameters)
    assert len(scenes) == 3
    assert all(len(scene) == 3000 and scene["core"].all() for scene in scenes.values())


def test_splits_along_the_way_share_no_point_and_leave_the_gap_out(project, tmp_path, rng):
    xyz = road(rng, 0, 100, 6000)
    write(tmp_path / "survey/street.laz", xyz, label=labels(6000))
    stops = np.array([[0.0, 0.0, 0.0, 2.0], [10.0, 100.0, 0.0, 2.0]]) + np.append(0.0, ORIGIN)
    pd.DataFrame(stops, columns=["time", "x", "y", "z"]).to_csv(tmp_path / "survey/trajectory.csv", index=False)
    splits = {
        "train": {"files": ["*.laz"], "along": [0.0, 0.6], "gap": 4.0},
        "test": {"files": ["*.laz"], "along": [0.6, 1.0], "gap": 4.0},
    }
    parameters = given(tmp_path, survey={"splits": splits})
    run(project, "ingest", **parameters)
    scenes = loaded(project, "scenes", **parameters)
    x = {split: [] for split in splits}
    for key, scene in scenes.items():
        x[key.partition(".")[0]].append((scene.world_xyz() - ORIGIN)[:, 0])  # buffers too
    train, test = np.concatenate(x["train"]), np.concatenate(x["test"])
    assert train.max() < 60 < test.min() and test.min() - train.max() == pytest.approx(4.0, abs=0.2)
    assert train.min() < 0.5 and test.max() > 99.5


def test_outlier_filter_keeps_its_points_in_place_and_marks_them(project, tmp_path, rng):
    xyz = np.concatenate([road(rng, 0, 20), [[10.0, 0.0, 30.0]]])
    write(tmp_path / "survey/train/a.laz", xyz, label=labels(3001))
    write(tmp_path / "survey/test/b.laz", xyz, label=labels(3001))
    parameters = given(tmp_path, ingest={"cut": "file", "outliers": {"enabled": True}})
    run(project, "ingest", **parameters)
    run(project, "ground_removal", **parameters)
    filtered = loaded(project, "ground", **parameters)
    for key, scene in loaded(project, "scenes", **parameters).items():
        stray = int(np.flatnonzero(scene["row"] == 3000)[0])
        assert len(scene) == 3001 and scene["outlier"][stray] and scene["outlier"].mean() < 0.02
        ground = filtered[key]
        assert not ground["ground"][stray] and np.isnan(ground["height"][stray])
        assert ground["ground"][~scene["outlier"]].mean() > 0.95


def test_inspect_lists_what_is_wrong_with_each_file(project, tmp_path, rng, caplog):
    xyz = road(rng, 0, 20)
    doubled = np.concatenate([xyz, xyz[:40]])
    late = np.where(np.arange(3000) < 1500, 0.0, 60.0)
    write(tmp_path / "survey/train/a.laz", doubled, label=labels(3040))
    cloud = PointCloud(xyz, {"gps_time": np.sort(late + rng.uniform(0, 0.5, 3000)), "label": labels(3000)}, ORIGIN)
    (tmp_path / "survey/test").mkdir()
    LasFormat().write(tmp_path / "survey/test/b.laz", cloud, WriteOptions(like="none"))
    run(project, "inspect", **given(tmp_path))
    table = pd.read_csv(project / "data/08_reporting/survey_warnings.csv")
    told = table.groupby("file")["warning"].apply(" ".join)
    assert "40 points repeat another exactly" in told["train/a.laz"] and "59" in told["test/b.laz"]
    assert any(message.startswith("train/a.laz: ") for message in caplog.messages)


def test_oakland_blocks_run_from_end_to_end(project, real_data, tmp_path):
    blocks = sorted(real_data("oakland").glob("*.gz"))
    (tmp_path / "survey").mkdir()
    for part, letters in (("part2", "[cehjkm]"), ("part3", "[!cehjkm]")):  # as conf/oakland splits them
        chosen = next(block for block in blocks if block.match(f"*{part}_a{letters}.*"))
        shutil.copy(chosen, tmp_path / "survey")
    changes = {"detrended_forest": {"n_trees": 30}, "execution": {"backend": "sequential"}}
    scored = ["score_detrended_forest", "score_ground_removal"]
    run(project, env="oakland", to_nodes=scored, survey={"root": str(tmp_path / "survey")}, **changes)
    scores = pd.read_csv(project / "data/08_reporting/oakland/scores/detrended_forest.csv")
    value = scores.set_index(["class", "metric"])["value"]
    assert value["all", "overall_accuracy"] > 0.85
    assert set(scores["class"]) == {"wire", "pole", "ground", "facade", "vegetation", "all"}
    ground = pd.read_csv(project / "data/08_reporting/oakland/ground_scores.csv").set_index("split")
    assert ground.loc["test", "total"] < 0.05


def test_semantickitti_scan_is_split_by_sectors_with_a_gap(project, real_data):
    parameters = {"survey": {"root": str(real_data("semantickitti"))}, "execution": {"backend": "sequential"}}
    run(project, "ingest", env="semantickitti", **parameters)
    with session_of(project, env="semantickitti", **parameters) as session:
        found = session.load_context().catalog.load("scenes")
        scenes = {key: handle.load() for key, handle in found.items()}
    azimuth = {}
    for key, scene in scenes.items():
        world = scene.world_xyz()
        angle = np.degrees(np.arctan2(world[:, 1], world[:, 0])) % 360
        azimuth[key.partition(".")[0]] = angle
    train, test = azimuth["train"], azimuth["test"]
    assert len(train) > 40_000 and len(test) > 30_000
    assert not ((train > 148.5) & (train < 211.5)).any() and not ((train > 328.5) | (train < 31.5)).any()
    assert not ((test > 31.5) & (test < 148.5)).any() and not ((test > 211.5) & (test < 328.5)).any()


def test_files_that_would_get_one_name_in_the_stores_are_named(project, tmp_path, rng):
    for name in ("train/a b.laz", "train/a_b.laz", "test/c.laz"):
        write(tmp_path / "survey" / name, road(rng, 0, 5, 100), label=labels(100))
    with pytest.raises(
        Exception, match=r"same key train\.train_a_b_laz in the stores, rename one: train/a b\.laz, train/a_b\.laz"
    ):
        run(project, "ingest", **given(tmp_path))

"""Scenes: every point in one core, nothing lost, whatever the ranges."""

import numpy as np
import pytest

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud, concatenate
from mlsroad_pipeline.algorithms.scenes import joining
from mlsroad_pipeline.algorithms.scenes.binning import BinnedCloud, cut_range
from mlsroad_pipeline.algorithms.scenes.corridor import MainAxis, main_axis
from mlsroad_pipeline.algorithms.scenes.joining import assemble_scene, plan_scenes
from mlsroad_pipeline.algorithms.scenes.trajectory import Trajectory

UTM = np.array([583_000.0, 4_477_000.0, 120.0])
PLAN = {"scene_length": 20.0, "buffer": 5.0, "bin_length": 2.0, "max_points": 10**6}


@pytest.fixture
def path():
    s = np.linspace(0, 100, 101)
    return Trajectory.from_positions(np.column_stack([s, 20 * np.sin(s / 30), 0 * s]) + UTM)


@pytest.fixture
def files(rng):
    """Two files of one street, the second with its own origin and an extra column."""
    one = PointCloud(
        rng.uniform([-10, -15, 0], [70, 40, 5], (3000, 3)), {"intensity": rng.random(3000)}, UTM, "X", "a.laz"
    )
    extra = {"intensity": rng.random(2000), "echo": np.ones(2000)}
    two = PointCloud(
        rng.uniform([0, -35, -20], [60, 20, -15], (2000, 3)), extra, UTM + np.array([50, 20, 20]), "X", "b.laz"
    )
    return [one, two]


def cut_all(files, corridor, size, bin_length=2.0):
    return [
        cut_range(cloud.select(np.s_[i : i + size]), corridor, bin_length=bin_length, first_row=i, file=number)
        for number, cloud in enumerate(files)
        for i in range(0, len(cloud), size)
    ]


def histogram(pieces):
    total = {}
    for piece in pieces:
        for number, count in piece.histogram().items():
            total[number] = total.get(number, 0) + count
    return total


def same(a, b):
    assert a.columns.keys() == b.columns.keys()
    assert a.xyz.tobytes() == b.xyz.tobytes()
    assert a.origin.tobytes() == b.origin.tobytes()
    assert a.crs == b.crs
    for name in a.columns:
        assert a[name].dtype == b[name].dtype
        assert a[name].tobytes() == b[name].tobytes()


def test_each_point_is_in_the_core_of_one_scene(files, path):
    pieces = cut_all(files, path, 700)
    spans = plan_scenes(histogram(pieces), **PLAN)
    seen = []
    for span in spans:
        scene = assemble_scene(pieces, span)
        core = scene.select(scene["core"])
        assert (len(core), len(scene)) == (span.n_core, span.n_points)
        seen += list(zip(core["file"].tolist(), core["row"].tolist(), strict=True))
        original = np.array([files[f].world_xyz()[r] for f, r in zip(scene["file"], scene["row"], strict=True)])
        np.testing.assert_allclose(scene.world_xyz(), original, atol=1e-8)
        expected = [files[f]["intensity"][r] for f, r in zip(scene["file"], scene["row"], strict=True)]
        np.testing.assert_array_equal(scene["intensity"], expected)
    assert sorted(seen) == [(f, r) for f, n in enumerate([3000, 2000]) for r in range(n)]
    assert len(spans) >= 4


def test_scene_does_not_depend_on_the_ranges_or_their_order(files, path, rng):
    whole, small = cut_all(files, path, 10_000), cut_all(files, path, 333)
    shuffled = [small[i] for i in rng.permutation(len(small))]
    assert histogram(whole) == histogram(small)
    for span in plan_scenes(histogram(whole), **PLAN):
        slices = [piece.between(span.buffer_first, span.buffer_stop) for piece in shuffled]
        same(assemble_scene(whole, span), assemble_scene(slices, span))


def test_buffer_holds_every_point_within_its_width(files, path):
    pieces = cut_all(files, path, 900)
    for span in plan_scenes(histogram(pieces), **PLAN):
        scene = assemble_scene(pieces, span)
        got = set(zip(scene["file"].tolist(), scene["row"].tolist(), strict=True))
        low, high = span.first * 2.0 - 5.0, span.stop * 2.0 + 5.0
        for number, cloud in enumerate(files):
            station, _ = path.locate(cloud.xyz, origin=cloud.origin)
            near = np.flatnonzero((station >= low) & (station < high))
            assert {(number, int(row)) for row in near} <= got
        stations, _ = path.locate(scene.xyz, origin=scene.origin)
        np.testing.assert_array_equal(scene["core"], (stations >= span.first * 2.0) & (stations < span.stop * 2.0))


def test_context_surrounds_the_buffers_and_is_thinned_where_it_has_many_points(files, path, monkeypatch, rng):
    pieces = cut_all(files, path, 900)
    plain = plan_scenes(histogram(pieces), **PLAN)
    for span, before in zip(plan_scenes(histogram(pieces), **PLAN, context=12.0), plain, strict=True):
        assert span.context_step == 1
        scene, core = assemble_scene(pieces, span), assemble_scene(pieces, before)
        near = scene.select(scene["near"])
        for name in ("file", "row", "core"):
            assert np.array_equal(near[name], core[name])
        stations, _ = path.locate(scene.xyz, origin=scene.origin)
        assert stations.min() >= span.first * 2.0 - 6.0 - 12.0 and (~scene["near"]).any()
    monkeypatch.setattr(joining, "CONTEXT_POINTS", 100)
    small = cut_all(files, path, 333)
    shuffled = [small[i] for i in rng.permutation(len(small))]
    whole = plan_scenes(histogram(pieces), **PLAN, context=12.0)
    for span in whole:
        scene = assemble_scene(pieces, span)
        same(assemble_scene(shuffled, span), scene)
        outer, most = int((~scene["near"]).sum()), max(span.n_core // 4, 100)
        assert int(scene["near"].sum()) == span.n_points and 0.3 * most < outer < 1.3 * most
    assert max(span.context_step for span in whole) > 1


def test_pieces_survive_storage(files, path, tmp_path):
    piece = cut_all(files, path, 10_000)[1]
    np.savez(tmp_path / "piece.npz", **piece.to_arrays())
    with np.load(tmp_path / "piece.npz") as stored:
        back = BinnedCloud.from_arrays(stored)
    same(back.cloud, piece.cloud)
    np.testing.assert_array_equal(back.bins, piece.bins)
    np.testing.assert_array_equal(back.indptr, piece.indptr)
    assert back.cloud.source == "b.laz"


def test_bins_keep_the_files_order_and_the_input(files, path):
    before = files[0].xyz.copy()
    piece = cut_range(files[0], path, bin_length=2.0, first_row=40, file=3)
    np.testing.assert_array_equal(files[0].xyz, before)
    for low, high in zip(piece.indptr[:-1], piece.indptr[1:], strict=True):
        assert (np.diff(piece.cloud["row"][low:high]) > 0).all()
    assert piece.cloud["row"].min() == 40
    assert (piece.cloud["file"] == 3).all()


def test_without_a_corridor_each_file_is_a_bin(files):
    pieces = cut_all(files, None, 800)
    assert histogram(pieces) == {0: 3000, 1: 2000}
    spans = plan_scenes(histogram(pieces), scene_length=1, buffer=0, bin_length=1, max_points=1)
    assert [len(assemble_scene(pieces, span)) for span in spans] == [3000, 2000]


def test_main_axis_of_a_planted_street(rng):
    direction = np.array([np.cos(0.4), np.sin(0.4)])
    along, across = rng.uniform(-80, 80, 5000), rng.uniform(-5, 5, 5000)
    xy = along[:, None] * direction + across[:, None] * [direction[1], -direction[0]]
    axis = main_axis(np.column_stack([xy, np.zeros(5000)]) + UTM)
    assert isinstance(axis, MainAxis)
    assert axis.direction @ direction > np.cos(np.radians(0.5))
    exact = MainAxis(UTM[:2], direction)
    station, offset = exact.locate(np.column_stack([xy, np.zeros(5000)]), origin=UTM)
    np.testing.assert_allclose(station, along, atol=1e-8)
    np.testing.assert_allclose(offset, across, atol=1e-8)


def test_scenes_have_the_planned_length_and_skip_gaps():
    counts = {b: 10 for b in [*range(25), *range(60, 70)]}
    spans = plan_scenes(counts, scene_length=10, buffer=2, bin_length=1, max_points=1000)
    assert [(s.first, s.stop) for s in spans] == [(0, 10), (10, 20), (20, 25), (60, 70)]
    assert [(s.buffer_first, s.buffer_stop) for s in spans][1] == (8, 22)
    assert [s.id for s in spans] == ["scene_00000", "scene_00001", "scene_00002", "scene_00003"]
    assert [s.n_points for s in spans] == [120, 140, 70, 100]


def test_dense_places_make_short_scenes():
    counts = {0: 10, 1: 10, 2: 90, 3: 150, 4: 10, 5: 10, 6: 10}
    spans = plan_scenes(counts, scene_length=5, buffer=0, bin_length=1, max_points=100)
    assert [(s.first, s.stop, s.n_core) for s in spans] == [(0, 2, 20), (2, 3, 90), (3, 4, 150), (4, 7, 30)]


def test_a_tiny_last_scene_joins_the_one_before():
    counts = {b: 10 for b in range(22)}
    plan = {"scene_length": 10, "buffer": 0, "bin_length": 1}
    assert [(s.first, s.stop) for s in plan_scenes(counts, **plan, max_points=120)] == [(0, 10), (10, 22)]
    assert [(s.first, s.stop) for s in plan_scenes(counts, **plan, max_points=119)] == [(0, 10), (10, 20), (20, 22)]


@pytest.mark.parametrize("seed", range(20))
def test_every_bin_is_in_one_core(seed):
    rng = np.random.default_rng(seed)
    counts = {int(b): int(n) for b, n in zip(rng.integers(-50, 200, 90), rng.integers(0, 100, 90), strict=True)}
    spans = plan_scenes(counts, scene_length=12, buffer=3, bin_length=1, max_points=250)
    for number, n in counts.items():
        assert sum(s.first <= number < s.stop for s in spans) == (n > 0) or n == 0
        assert sum(s.first <= number < s.stop for s in spans) <= 1
    assert sum(s.n_core for s in spans) == sum(counts.values())
    assert spans == plan_scenes(dict(reversed(counts.items())), scene_length=12, buffer=3, bin_length=1, max_points=250)


def test_empty_survey_has_no_scenes(path):
    assert plan_scenes({}, **PLAN) == []
    empty = cut_range(PointCloud(np.zeros((0, 3))), path, bin_length=1.0, first_row=0)
    assert (len(empty), empty.histogram()) == (0, {})


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"scene_length": 0}, "scene_length must be"),
        ({"bin_length": -1}, "bin_length must be"),
        ({"buffer": -1}, "buffer must be a finite number >= 0, got -1"),
        ({"buffer": np.nan}, "buffer must be a finite number"),
        ({"context": -2.0}, "context must be a finite number >= 0, got -2.0"),
        ({"max_points": 0}, "max_points must be at least 1, got 0"),
    ],
)
def test_bad_plans(change, message):
    with pytest.raises(ParameterError, match=message):
        plan_scenes({0: 1}, **{**PLAN, **change})


def test_bad_ranges(files, path):
    with pytest.raises(ParameterError, match="first_row must not be negative"):
        cut_range(files[0], path, bin_length=1.0, first_row=-1)
    with pytest.raises(ParameterError, match=r"file must be in 0\.\.32767.*40000"):
        cut_range(files[0], path, bin_length=1.0, first_row=0, file=40000)
    with pytest.raises(DataError, match=r"a\.laz has a column 'row'"):
        cut_range(files[0].with_columns(row=np.zeros(3000)), path, bin_length=1.0, first_row=0)
    with pytest.raises(DataError, match="no main axis"):
        main_axis(np.ones((5, 3)))
    with pytest.raises(DataError, match="at least 2 points"):
        main_axis(np.ones((1, 3)))


def test_bad_scenes(files, path):
    pieces = cut_all(files, path, 10_000)
    span = plan_scenes(histogram(pieces), **PLAN)[0]
    with pytest.raises(DataError, match=r"scene_00000: row .* occurs in two pieces"):
        assemble_scene([*pieces, pieces[0]], span)
    with pytest.raises(DataError, match="scene_00000: none of 0 pieces"):
        assemble_scene([], span)


@pytest.mark.filterwarnings("error")
def test_points_at_any_distance_have_a_bin(path):
    xyz = np.array([[0.0, 0, 0], [1e14, 1e14, 0], [-1e14, -1e14, 0], [10, 0, 0]])
    cut = cut_range(PointCloud(xyz, {}, UTM, None, "a.txt"), path, bin_length=2.0, first_row=0)
    assert sorted(cut.cloud["row"].tolist()) == [0, 1, 2, 3]
    assert (np.diff(cut.bins.astype(np.int64)) > 0).all() and len(cut.bins) == 4


def test_rows_of_clouds_are_joined_in_their_order(rng):
    first = PointCloud(rng.random((5, 3)), {"a": np.arange(5, dtype=np.int16), "b": np.zeros(5)}, np.array([1.0, 2, 3]))
    second = PointCloud(rng.random((4, 3)), {"a": np.arange(10, 14)}, np.array([2.0, 2, 3]))
    rows = [np.array([4, 0, 2]), np.array([3, 3])]
    joined = concatenate([first, second], rows)
    same(joined, concatenate([first.select(rows[0]), second.select(rows[1])]))
    assert joined["a"].tolist() == [4, 0, 2, 13, 13] and list(joined.columns) == ["a"]

"""Parameters of given classes, and files of predictions."""

import numpy as np
import pytest
from helpers.labelled import scheme as configured_scheme

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.core.codings import CODE_NAMES
from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError, ReadError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.formats.base import WriteOptions
from mlsroad_pipeline.formats.kitti import write_labels
from mlsroad_pipeline.formats.las.format import LasFormat
from mlsroad_pipeline.surveys.class_map_files import read_class_map
from mlsroad_pipeline.surveys.given_classes import GivenParameters, given_columns, prediction_file, read_predictions

SCHEME = ClassScheme.from_config("road_inventory", configured_scheme())


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"keeep": 1}, r"label\.given has no parameter 'keeep'"),
        ({"keep_classes": "yes"}, r"label\.given\.keep_classes must be true or false, got 'yes'"),
        ({"keep": "2"}, r"label\.given\.keep chooses among kept classes"),
        ({"keep_classes": True, "keep": "2,x"}, r"label\.given\.keep must list class numbers.*got '2,x'"),
        ({"classes": "oakland"}, r"label\.given\.classes has no effect: set label\.given\.keep_classes too"),
        ({"labels_classes": "a.csv"}, r"label\.given\.labels_classes has no effect: set label\.given\.labels too"),
        ({"labels": 3}, r"label\.given\.labels must be a text, got 3"),
        ({"labels": "f", "weight": 1.5}, r"label\.given\.weight must be a number between 0 and 1, got 1\.5"),
        ({"labels": "f", "weight": "half"}, r"label\.given\.weight must be a number between 0 and 1, got 'half'"),
        ({"weight": 0.5}, r"label\.given\.weight is that of predictions"),
    ],
)
def test_wrong_parameters_are_named_with_their_value(given, message):
    with pytest.raises(ParameterError, match=message):
        GivenParameters.from_config(given)


@pytest.mark.parametrize("name", ["asprs", "toronto3d", "paris_lille3d", "mlsroad"])
def test_shipped_class_maps_fit_the_scheme(name):
    assert (read_class_map(name, SCHEME).labels(SCHEME) >= 0).sum() >= 8


@pytest.mark.parametrize("keep", ["6,2", [2, 6], (6, 2, 2)])
def test_chosen_numbers_are_given_as_text_or_list(keep):
    assert GivenParameters.from_config({"keep_classes": True, "keep": keep}).keep == (2, 6)


def test_class_maps_cover_their_codes_and_fit_the_scheme():
    asprs = read_class_map("asprs", SCHEME)
    assert set(CODE_NAMES) <= set(asprs.numbers)
    of_results = read_class_map("mlsroad", SCHEME)
    place = of_results.places(SCHEME.codes(), source="s")
    assert of_results.labels(SCHEME)[place].tolist() == list(range(len(SCHEME)))
    for code in SCHEME.codes().tolist():  # results can be read by either map: the ground alone is ambiguous
        label = asprs.labels(SCHEME)[asprs.numbers.index(code)]
        assert SCHEME.codes()[label] == code or code == 2
    coding = read_class_map("streets", SCHEME, codings={"streets": {7: "road", 9: "unlabelled"}})
    assert coding.numbers == (7, 9) and coding.classes == ("road", "unlabelled")


def test_numbers_that_a_map_lacks_are_errors():
    given = GivenParameters(keep_classes=True, keep=(2, 99))
    with pytest.raises(ParameterError, match=r"label\.given\.keep: class number 99 is not in class map asprs"):
        given.kept_legend(SCHEME, {})
    with pytest.raises(DataError, match=r"f\.laz: class number 99 \(2 points\) is not in asprs"):
        read_class_map("asprs", SCHEME).places(np.array([2, 99, 99]), source="f.laz")
    with pytest.raises(ParameterError, match=r"labels_classes is not set: name the class map of x \(\.npy\)"):
        GivenParameters(labels="x").predicted_legend(SCHEME, {}, {".npy"})


def test_kept_numbers_are_those_of_the_file():
    cloud = PointCloud(np.zeros((3, 3), np.float32), {"classification": np.array([2, 5, 6], np.uint8)})
    chosen = GivenParameters(keep_classes=True, keep=(2, 6))
    assert given_columns(cloud, chosen, None, path="a", start=0, n_total=3)["kept"].tolist() == [2, -1, 6]
    with pytest.raises(DataError, match=r"a\.ply has no column of classes to keep"):
        given_columns(cloud.without_columns(["classification"]), chosen, None, path="a.ply", start=0, n_total=3)


def write(path, numbers):
    if path.suffix == ".npz":
        np.savez(path, numbers)
    elif path.suffix == ".npy":
        np.save(path, numbers)
    elif path.suffix == ".label":
        write_labels(path, numbers, np.arange(len(numbers)))
    else:
        columns = {"classification": numbers.astype(np.uint8), "confidence": np.full(len(numbers), 0.3, np.float32)}
        LasFormat().write(path, PointCloud(np.zeros((len(numbers), 3)), columns), WriteOptions())


@pytest.mark.parametrize("suffix", [".npy", ".npz", ".label", ".laz"])
def test_predictions_of_each_format_are_read_by_rows(tmp_path, suffix):
    path, numbers = tmp_path / f"a{suffix}", np.arange(40) % 7
    write(path, numbers)
    read = read_predictions(path, 10, 25, 40, "a.laz")
    assert np.array_equal(read["predicted"], numbers[10:25])
    if suffix == ".laz":
        assert read["predicted_confidence"] == pytest.approx(0.3)
    with pytest.raises(ReadError, match=rf"a\{suffix} has 40 labels for the 41 points of a\.laz"):
        read_predictions(path, 0, 5, 41, "a.laz")


def test_probabilities_are_checked(tmp_path, rng):
    p = rng.dirichlet(np.ones(4), 30).astype(np.float32)
    np.save(tmp_path / "p.npy", p)
    assert np.array_equal(read_predictions(tmp_path / "p.npy", 3, 9, 30, "a")["predicted_probabilities"], p[3:9])
    p[5] *= 2
    np.savez(tmp_path / "p.npz", probabilities=p, other=np.zeros(2))
    with pytest.raises(ReadError, match=r"p\.npz: the probabilities of row 5 sum to 2 with minimum .*\(1 rows\)"):
        read_predictions(tmp_path / "p.npz", 3, 9, 30, "a")


@pytest.mark.parametrize(
    ("array", "message"),
    [
        (np.full(4, 0.5), "class numbers are float64, not whole numbers"),
        (np.zeros((4, 3), int), "probabilities are int64, not floats"),
        (np.zeros((4, 3, 2)), r"shape \(4, 3, 2\)"),
        (np.array(["a"] * 4), "class numbers are <U1"),
    ],
)
def test_other_arrays_are_refused(tmp_path, array, message):
    np.save(tmp_path / "a.npy", array)
    with pytest.raises(ReadError, match=rf"a\.npy: .*{message}"):
        read_predictions(tmp_path / "a.npy", 0, 4, 4, "a.laz")


def test_damaged_and_unnamed_arrays_are_refused(tmp_path):
    (tmp_path / "a.npy").write_bytes(b"\x93NUMPY damaged")
    with pytest.raises(ReadError, match=r"a\.npy: cannot be read as NPY"):
        read_predictions(tmp_path / "a.npy", 0, 4, 4, "a.laz")
    np.savez(tmp_path / "b.npz", one=np.zeros(4), two=np.zeros(4))
    with pytest.raises(ReadError, match=r"b\.npz has arrays one, two: name one probabilities or labels or classes"):
        read_predictions(tmp_path / "b.npz", 0, 4, 4, "a.laz")


def test_a_file_of_predictions_has_the_name_of_its_cloud(tmp_path):
    (tmp_path / "tiles").mkdir()
    for name in ("tiles/a.npz", "b_pred.npy", "c.label", "e.ply.npy"):
        (tmp_path / name).touch()
    found = [prediction_file(str(tmp_path), name) for name in ("tiles/a.laz", "tiles/b.copc.laz", "c.txt.gz", "e.ply")]
    assert found == [str(tmp_path / name) for name in ("tiles/a.npz", "b_pred.npy", "c.label", "e.ply.npy")]
    with pytest.raises(ReadError, match=r"no labels of d\.laz: neither d\.npy"):
        prediction_file(str(tmp_path), "d.laz")
    with pytest.raises(ReadError, match=r"none is not a folder \(label\.given\.labels\)"):
        prediction_file(str(tmp_path / "none"), "d.laz")

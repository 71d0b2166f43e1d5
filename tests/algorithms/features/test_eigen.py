"""Eigenvalue features against numpy.linalg.eigh, closed forms and their invariances."""

import numpy as np
import pytest
from references.forest import eigen_features, radius_lists

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.features.eigen import EIGEN_FEATURES, SHAPE_FEATURES, compute_eigen_features
from mlsroad_pipeline.algorithms.features.eigen_solver import solve_symmetric
from mlsroad_pipeline.algorithms.geometry.neighbors import nearest_neighbors

VECTORS = ("nx", "ny", "nz", "direction_x", "direction_y", "direction_z")


def street(rng, n=1500):
    """A ground patch, a wall, a pole and a bush."""
    ground = np.c_[rng.random((n, 2)) * 3, rng.normal(0, 0.005, n)]
    wall = np.c_[rng.random(n) * 3, rng.normal(3, 0.01, n), rng.random(n) * 2]
    angle = rng.random(n // 5) * 2 * np.pi
    pole = np.c_[1 + 0.06 * np.cos(angle), 1 + 0.06 * np.sin(angle), rng.random(n // 5) * 2]
    return np.vstack([ground, wall, pole, rng.normal([2, 1, 1], 0.2, (n // 2, 3))])


def solve(matrices):
    packed = np.ascontiguousarray(matrices[:, [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]].T)
    n = len(matrices)
    values, smallest, largest = np.empty((3, n)), np.empty((3, n)), np.empty((3, n))
    solve_symmetric(packed, n, values, smallest, largest)
    return values.T, smallest.T, largest.T


def test_the_solver_equals_eigh_from_needles_to_spheres(rng):
    n = 4000
    scales = np.sort(10.0 ** rng.uniform(-9, 0, (n, 3)), axis=1)
    scales[:400] = [1, 1, 1]
    scales[400:800] = [0, 1, 1]
    scales[800:1200] = [0, 0, 1]
    scales[1200:1600] = 0
    turn = np.linalg.qr(rng.normal(size=(n, 3, 3)))[0]
    matrices = (turn * scales[:, None, :]) @ turn.transpose(0, 2, 1)
    matrices[:, [1, 2, 2], [0, 0, 1]] = matrices[:, [0, 0, 1], [1, 2, 2]]
    values, smallest, largest = solve(matrices)
    expected = np.maximum(np.linalg.eigvalsh(matrices)[:, ::-1], 0)
    assert np.abs(values - expected).max() < 1e-14
    for vector, value in ((smallest, values[:, 2]), (largest, values[:, 0])):
        assert np.abs(np.linalg.norm(vector, axis=1) - 1).max() < 1e-12
        assert np.abs(np.einsum("nij,nj->ni", matrices, vector) - value[:, None] * vector).max() < 1e-14
        assert vector[:, 2].min() >= 0
    assert np.abs((smallest * largest).sum(axis=1)).max() < 1e-12


def check_against_reference(features, xyz, neighborhoods, scale):
    """Hold every feature to the stated tolerance: 1e-6 of the largest eigenvalue in the covariance."""
    checked = 0
    for i, neighbors in enumerate(neighborhoods):
        if len(neighbors) < 3:
            continue
        expected = eigen_features(xyz[neighbors])
        if expected["eigenvalue_2"] < 1e-4 * expected["eigenvalue_1"]:
            continue  # nearly a line: the relative features are compared elsewhere
        assert features["neighbor_count"][i] == expected["neighbor_count"]
        for j in (1, 2, 3):
            name = f"eigenvalue_{j}"
            assert abs(features[name][i] - expected[name]) <= 1e-6 * expected["eigenvalue_1"] + 1e-7 * scale
        for name in SHAPE_FEATURES:
            tolerance = 0.01 if name == "omnivariance" else 2e-5  # a cube root of what may be a tiny eigenvalue
            assert features[name][i] == pytest.approx(expected[name], abs=tolerance), name
        gap = (expected["eigenvalue_2"] - expected["eigenvalue_3"]) / expected["eigenvalue_1"]
        if gap > 0.01:
            normal = np.array([features[name][i] for name in VECTORS[:3]])
            assert abs(normal @ expected["normal"]) > 1 - 1e-6
            assert features["verticality"][i] == pytest.approx(expected["verticality"], abs=1e-4)
        if expected["linearity"] > 0.01:
            direction = np.array([features[name][i] for name in VECTORS[3:]])
            assert abs(direction @ expected["direction"]) > 1 - 1e-6
        checked += 1
    return checked


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_radius_features_equal_eigh(rng, dtype):
    xyz = street(rng).astype(dtype)
    features = compute_eigen_features(xyz, radius=0.3)
    assert list(features) == list(EIGEN_FEATURES)
    assert all(column.dtype == np.float32 and column.shape == (len(xyz),) for column in features.values())
    sample = rng.choice(len(xyz), 300, replace=False)
    neighborhoods = radius_lists(xyz.astype(float), 0.3, xyz[sample].astype(float))
    picked = {name: column[sample] for name, column in features.items()}
    assert check_against_reference(picked, xyz.astype(float), neighborhoods, 0.3**2) > 250


def test_nearest_features_equal_eigh(rng):
    xyz = street(rng, 500)
    features = compute_eigen_features(xyz, k=20)
    neighborhoods = nearest_neighbors(xyz, k=20)[0].reshape(-1, 20)
    assert check_against_reference(features, xyz, neighborhoods, 0.01) > 900


def test_a_plane_a_line_and_a_sphere_have_their_textbook_values(rng):
    angle = np.linspace(0, 2 * np.pi, 200, endpoint=False)
    disc = np.vstack([np.c_[r * np.cos(angle), r * np.sin(angle), 0 * angle] for r in np.linspace(0.1, 1, 10)])
    plane = {name: column[0] for name, column in compute_eigen_features(disc, radius=3).items()}
    assert plane["planarity"] == pytest.approx(1, abs=1e-5)
    assert plane["linearity"] == pytest.approx(0, abs=1e-5)
    assert plane["eigenentropy"] == pytest.approx(np.log(2), abs=1e-5)
    assert (plane["nz"], plane["verticality"]) == (pytest.approx(1), pytest.approx(0, abs=1e-6))
    wire = np.c_[np.linspace(-1, 1, 101), np.zeros((101, 2))]
    line = {name: column[50] for name, column in compute_eigen_features(wire, radius=3).items()}
    assert line["linearity"] == pytest.approx(1)
    assert line["eigenvalue_1"] == pytest.approx(np.var(wire[:, 0]))
    assert abs(line["direction_x"]) == pytest.approx(1)
    assert np.isnan([line["nx"], line["ny"], line["nz"], line["verticality"]]).all()
    octahedron = np.vstack([np.eye(3), -np.eye(3)])
    ball = {name: column[0] for name, column in compute_eigen_features(octahedron, radius=3).items()}
    assert ball["scattering"] == pytest.approx(1)
    assert ball["change_of_curvature"] == pytest.approx(1 / 3)
    assert ball["omnivariance"] == pytest.approx(1 / 3)
    assert ball["eigenentropy"] == pytest.approx(np.log(3))


def test_undefined_values_are_nan():
    pair = compute_eigen_features(np.array([[0.0, 0, 0], [0.1, 0, 0]]), radius=1)
    assert pair["neighbor_count"].tolist() == [2, 2]
    assert all(np.isnan(column).all() for name, column in pair.items() if name != "neighbor_count")
    same = compute_eigen_features(np.ones((5, 3)), radius=1)
    assert same["neighbor_count"].tolist() == [5] * 5
    for name, column in same.items():
        if name.startswith("eigenvalue"):
            assert column.tolist() == [0] * 5
        elif name != "neighbor_count":
            assert np.isnan(column).all(), name
    assert all(len(column) == 0 for column in compute_eigen_features(np.empty((0, 3)), radius=1).values())


def test_features_do_not_depend_on_order_place_heading_or_threads(rng):
    xyz = street(rng, 400)
    base = compute_eigen_features(xyz, radius=0.3)
    before = xyz.copy()
    threaded = compute_eigen_features(xyz, radius=0.3, n_threads=2)
    assert all(np.array_equal(base[name], threaded[name], equal_nan=True) for name in base)
    assert np.array_equal(xyz, before)
    order = rng.permutation(len(xyz))
    shuffled = compute_eigen_features(xyz[order], radius=0.3)
    moved = compute_eigen_features(xyz + np.array([451_234.0, 5_412_987.0, 312.0]), radius=0.3)
    yaw = np.array([[np.cos(1), -np.sin(1), 0], [np.sin(1), np.cos(1), 0], [0, 0, 1]])
    turned = compute_eigen_features(xyz @ yaw.T, radius=0.3)
    for name in (*SHAPE_FEATURES, "eigenvalue_1", "neighbor_count"):
        tolerance = 5e-3 if name == "omnivariance" else 2e-5
        assert np.allclose(shuffled[name], base[name][order], atol=tolerance, equal_nan=True), name
        assert np.allclose(moved[name], base[name], atol=tolerance, equal_nan=True), name
        assert np.allclose(turned[name], base[name], atol=tolerance, equal_nan=True), name


def test_bad_input_is_named():
    xyz = np.zeros((4, 3))
    with pytest.raises(ParameterError, match="exactly one of radius and k, got radius=None and k=None"):
        compute_eigen_features(xyz)
    with pytest.raises(ParameterError, match="exactly one of radius and k, got radius=1 and k=3"):
        compute_eigen_features(xyz, radius=1, k=3)
    with pytest.raises(ParameterError, match=r"radius .*got nan"):
        compute_eigen_features(xyz, radius=np.nan)
    with pytest.raises(ParameterError, match="k must be at least 1"):
        compute_eigen_features(xyz, k=0)
    with pytest.raises(ParameterError, match="n_threads must be at least 1"):
        compute_eigen_features(xyz, radius=1, n_threads=0)
    with pytest.raises(DataError, match=r"shape \(n, 3\), got \(4, 2\)"):
        compute_eigen_features(xyz[:, :2], radius=1)
    with pytest.raises(DataError, match="NaN or infinite coordinates, the first at row 2"):
        compute_eigen_features(np.array([[0, 0, 0], [1, 1, 1], [0, 0, np.inf]]), radius=1)
    with pytest.raises(DataError, match="remove outliers"):
        compute_eigen_features(np.array([[0.0, 0, 0], [1e9, 1e9, 1e9]]), radius=1e-3)

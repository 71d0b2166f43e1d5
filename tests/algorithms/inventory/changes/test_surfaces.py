"""M3C2 distances against py4dgeo, a slow reference and closed forms; rasters and areas of planted changes."""

import numpy as np
import pytest

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.inventory.changes import surfaces
from mlsroad_pipeline.algorithms.inventory.changes.surfaces import (
    CELL,
    SURFACES,
    M3C2Parameters,
    SurfaceDistances,
    changed_areas,
    distance_raster,
    surface_distances,
)

ROAD, FACADE = SURFACES.index("road"), SURFACES.index("facade")
ORIGIN = np.array([389_300.0, 5_819_700.0, 34.0])
PARAMETERS = M3C2Parameters()


def plane(rng, n, noise=0.004, upright=False):
    points = np.column_stack([rng.uniform(0, 8, (n, 2)), rng.normal(0, noise, n)])
    return ORIGIN + (points[:, [0, 2, 1]] if upright else points)


def core_points(step=0.5, upright=False):
    x, y = (part.ravel() for part in np.meshgrid(np.arange(1, 7, step), np.arange(1, 7, step)))
    flat = np.column_stack([x, y, np.zeros(len(x))])
    return ORIGIN + (flat[:, [0, 2, 1]] if upright else flat)


def distances(first, second, core, surface=ROAD, path=None, error=0.0):
    return surface_distances(
        first, second, core, np.full(len(core), surface, np.uint8), path, registration_error=error,
        parameters=PARAMETERS,
    )  # fmt: skip


def test_distances_equal_those_of_py4dgeo(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    py4dgeo = surfaces.py4dgeo()
    rng = np.random.default_rng(1)
    first, second, core = plane(rng, 9000), plane(rng, 7000) + [0, 0, 0.03], core_points()
    found = distances(first, second, core, error=0.01)
    own = py4dgeo.M3C2(
        epochs=(py4dgeo.Epoch(first - ORIGIN), py4dgeo.Epoch(second - ORIGIN)), corepoints=core - ORIGIN,
        cyl_radius=PARAMETERS.cylinder, normal_radii=[PARAMETERS.normal], max_distance=PARAMETERS.reach,
        registration_error=0.01,
    )  # fmt: skip
    distance, uncertainty = own.run()
    assert found.distance == pytest.approx(distance, abs=1e-6)
    assert found.detection == pytest.approx(uncertainty["lodetection"], abs=1e-6)
    assert capsys.readouterr().out == "" and not list(tmp_path.iterdir())  # it logs nothing of its own


def test_distances_equal_a_slow_reference():
    rng = np.random.default_rng(2)
    first, second, core = plane(rng, 9000), plane(rng, 7000) + [0, 0, 0.03], core_points(1.5)
    found = distances(first, second, core, error=0.01)
    for k, point in enumerate(core):
        near = first[np.linalg.norm(first - point, axis=1) <= PARAMETERS.normal]
        normal = np.linalg.svd(near - near.mean(axis=0))[2][2]
        normal *= np.sign(normal[2])
        heights = []
        for cloud in (first, second):
            off = cloud - point
            along = off @ normal
            radial = np.linalg.norm(off - along[:, None] * normal, axis=1)
            heights.append(along[(radial <= PARAMETERS.cylinder) & (np.abs(along) <= PARAMETERS.reach)])
        assert found.distance[k] == pytest.approx(heights[1].mean() - heights[0].mean(), abs=1e-4)
        spread = np.sqrt(sum(h.var(ddof=1) / len(h) for h in heights))
        assert found.detection[k] == pytest.approx(1.96 * (spread + 0.01), rel=0.02)


def test_facades_are_positive_towards_the_path():
    rng = np.random.default_rng(3)
    wall, path = plane(rng, 9000, upright=True), ORIGIN + np.array([[x, -6.0, 2.0] for x in range(9)])
    nearer = plane(rng, 9000, upright=True) - [0, 0.1, 0]
    for side in (path, path + [0, 12, 0]):
        found = distances(wall, nearer, core_points(upright=True), FACADE, side)
        assert np.median(found.distance) == pytest.approx(0.1 if side is path else -0.1, abs=0.01)


def test_nothing_to_measure_gives_no_distance():
    nothing = np.zeros((0, 3))
    assert np.isnan(distances(nothing, core_points(), core_points()).distance).all()
    found = distances(nothing, nothing, nothing)
    assert distance_raster(found) is None and changed_areas(found)[0].empty


def planted():
    """Core points on a road with a patch of 4 x 2 m that was raised by 5 cm, and a row of single cells."""
    core = core_points(0.25)
    x, y = (core - ORIGIN)[:, :2].T
    distance = np.where((x >= 2) & (x < 6) & (y >= 2) & (y < 4), 0.05, 0.001)
    distance[(x < 1.5) & (y < 1.5)] = -0.2  # one cell alone
    distance[0] = np.nan
    return SurfaceDistances(core, np.full(len(core), ROAD, np.uint8), distance, np.full(len(core), 0.01))


def test_areas_are_those_of_the_planted_change():
    table, shapes = changed_areas(planted())
    assert table["surface"].tolist() == ["road"] and table["core_points"].tolist() == [16 * 8]
    assert table["mean_distance"].to_numpy() == pytest.approx([0.05]) and shapes[0].area == pytest.approx(8.0)
    assert shapes[0].bounds == pytest.approx((*(ORIGIN[:2] + 2), ORIGIN[0] + 6, ORIGIN[1] + 4))


def test_the_raster_has_its_rows_from_north_to_south():
    found = planted()
    raster = distance_raster(found)
    column, row = (2.25 - (raster.west - ORIGIN[0])) / CELL, (raster.north - ORIGIN[1] - 3.75) / CELL
    assert raster.values[int(row), int(column)] == pytest.approx(0.05)
    assert (raster.west, raster.north) == (ORIGIN[0] + 1, ORIGIN[1] + 7) and raster.values.shape == (12, 12)
    assert np.isfinite(raster.values).all()


def test_facades_have_no_raster():
    found = planted()
    assert distance_raster(found._replace(surface=np.full(len(found.xyz), FACADE, np.uint8))) is None


def test_the_missing_library_is_named(monkeypatch):
    def missing(name):
        raise ImportError(name)

    monkeypatch.setattr(surfaces, "import_module", missing)
    with pytest.raises(ParameterError, match=r"py4dgeo, which is not installed: install it .*--no-surfaces"):
        surfaces.py4dgeo()

"""Backgrounds of the map: pixels of GeoTIFF, MBTiles and PMTiles are where they belong; what cannot be shown is named."""

import base64
import io
import re

import numpy as np
import pandas as pd
import pytest
from helpers.backgrounds import number, tiles_of, write_geotiff, write_mbtiles, write_pmtiles
from PIL import Image
from pyproj import CRS, Transformer

from mlsroad_pipeline.algorithms.core.exceptions import MlsRoadError, ParameterError
from mlsroad_pipeline.reporting.clouds.pictures import MapFrame
from mlsroad_pipeline.reporting.html.objects import object_map_section
from mlsroad_pipeline.review.page_server.background import Background
from mlsroad_pipeline.review.page_server.tile_files import PmTiles
from mlsroad_pipeline.review.page_server.wanted import area_of, size_of

UTM32, UTM33 = CRS.from_epsg(25832), CRS.from_epsg(25833)
WEST, NORTH = 389_000.0, 5_819_800.0  # in UTM 33
AREA = (WEST + 20, NORTH - 120, WEST + 100, NORTH - 20)


def photo(n=400):
    """Return a picture whose red and green give column and row."""
    row, column = np.mgrid[:n, :n]
    return np.stack([column // 2, row // 2, np.full((n, n), 90)], axis=-1).astype(np.uint8)


def shown(background, area, size):
    content, kind = background.picture(area, size)
    return np.asarray(Image.open(io.BytesIO(content)).convert("RGBA")), kind


def test_pixels_of_a_geotiff_are_where_they_belong(tmp_path):
    write_geotiff(tmp_path / "photo.tif", photo(), WEST, NORTH, 0.5, epsg=25833)
    found, kind = shown(Background(tmp_path / "photo.tif", UTM33), AREA, (160, 200))  # half a metre per pixel
    assert kind == "image/jpeg"
    expected = photo()[40:240, 40:200].astype(int)
    assert np.abs(found[..., :3].astype(int) - expected).max() <= 4  # JPEG


@pytest.mark.parametrize(("system", "turn"), [(UTM33, 0.0), (UTM33, 35.0), (UTM32, 35.0)], ids=str)
def test_the_map_of_a_report_has_the_background_in_its_own_frame(tmp_path, system, turn):
    write_geotiff(tmp_path / "a<b.tif", photo(), WEST, NORTH, 0.5, epsg=25833)
    background = Background(tmp_path / "a<b.tif", system)
    middle = np.array(Transformer.from_crs(UTM33, system, always_xy=True).transform(WEST + 100, NORTH - 100))
    right, up = (np.array([np.cos(a), np.sin(a)]) for a in np.radians([turn, turn + 90]))
    frame = MapFrame(right, up, np.array([middle @ right - 40, middle @ up - 30]), np.array([80.0, 60.0]))
    rows = pd.DataFrame({"kind": ["pole"], "x": [middle[0]], "y": [middle[1]]})
    white = np.full((6, 8, 3), 255, np.uint8)
    page = f"<p>a</p>{object_map_section('Map', rows, frame, {'pole': 1}, background=white).body}<p>b</p>"
    changed = background.in_report(page)
    kind, _, text = re.search(r'href="data:([^;]*);base64,([^"]*)"', changed).expand(r"\1 \2").partition(" ")
    picture = np.asarray(Image.open(io.BytesIO(base64.b64decode(text))).convert("RGB")).astype(int)
    assert kind == "image/jpeg" and "a&lt;b.tif</label>" in changed and changed.endswith("<p>b</p>")
    back = Transformer.from_crs(system, UTM33, always_xy=True)
    for apart in ((0, 0), (25, 10), (-30, -20)):
        place = middle + apart[0] * right + apart[1] * up
        column, row = (frame.place(place[None])[0] / frame.size * picture.shape[1::-1]).astype(int)
        east, north = back.transform(*place)
        expected = photo()[int((NORTH - north) / 0.5), int((east - WEST) / 0.5)].astype(int)
        assert np.abs(picture[row, column] - expected).max() <= 5
    assert background.in_report("<p>a report of an earlier version</p>") == "<p>a report of an earlier version</p>"


@pytest.mark.parametrize("system", [UTM32, CRS.from_epsg(31469)], ids=["zone 32", "Gauss-Krueger, another datum"])
def test_a_geotiff_of_another_system_is_moved(tmp_path, system):
    write_geotiff(tmp_path / "photo.tif", photo(), WEST, NORTH, 0.5, epsg=25833)
    x, y = Transformer.from_crs(UTM33, system, always_xy=True).transform(WEST + 60, NORTH - 70)
    found, _ = shown(Background(tmp_path / "photo.tif", system), (x - 20, y - 20, x + 20, y + 20), (400, 400))
    back = Transformer.from_crs(system, UTM33, always_xy=True)
    for i, j in ((0, 0), (200, 200), (399, 0), (150, 399)):
        a, b = back.transform(x - 20 + (j + 0.5) / 10, y + 20 - (i + 0.5) / 10)
        expected = photo()[int((NORTH - b) / 0.5), int((a - WEST) / 0.5)].astype(int)
        assert np.abs(found[i, j, :3].astype(int) - expected).max() <= 5


def test_pixels_that_are_points_and_world_files_lie_half_a_pixel_apart(tmp_path):
    write_geotiff(tmp_path / "point.tif", photo(), WEST + 0.25, NORTH - 0.25, 0.5, epsg=25833, point=True)
    Image.fromarray(photo()).save(tmp_path / "world.tif")
    (tmp_path / "world.tfw").write_text(f"0.5\n0\n0\n-0.5\n{WEST + 0.25}\n{NORTH - 0.25}\n", encoding="ascii")
    write_geotiff(tmp_path / "area.tif", photo(), WEST, NORTH, 0.5, epsg=25833)
    pictures = [
        shown(Background(tmp_path / name, UTM33), AREA, (160, 200))[0]
        for name in ("point.tif", "world.tif", "area.tif")
    ]
    assert (pictures[0] == pictures[2]).all() and (pictures[1] == pictures[2]).all()


def test_a_photo_of_another_place_is_named_once(tmp_path, caplog):
    write_geotiff(tmp_path / "photo.tif", photo(), WEST, NORTH, 0.1, epsg=25833)
    background = Background(tmp_path / "photo.tif", UTM33)
    for _ in range(2):
        background.picture((WEST + 5000, NORTH - 10, WEST + 5010, NORTH), (20, 20))
    assert [record.getMessage() for record in caplog.records] == [
        f"{tmp_path / 'photo.tif'} shows nothing of the survey: it lies elsewhere, or its system is another one"
    ]


def test_beyond_a_geotiff_nothing_is_drawn_and_far_views_are_means(tmp_path):
    checks = np.where((np.indices((1600, 1600)).sum(axis=0) % 2)[..., None], 255, 0).astype(np.uint8).repeat(3, axis=2)
    write_geotiff(tmp_path / "photo.tif", checks, WEST, NORTH, 0.1, epsg=25833)
    found, kind = shown(
        Background(tmp_path / "photo.tif", UTM33), (WEST - 160, NORTH - 160, WEST + 160, NORTH), (200, 100)
    )
    assert kind == "image/png"
    assert (found[:, :99, 3] == 0).all() and (found[:, 101:, 3] == 255).all()
    assert np.abs(found[:, 101:, 0].astype(int) - 127).max() <= 2  # no moire of black and white


def colour(x, y):
    """Return a colour that follows the place in Web Mercator, 1 m per step."""
    return np.stack([x % 250, y % 250, np.full(x.shape, 20.0)], axis=-1).astype(np.uint8)


@pytest.fixture(scope="module")
def tiles():
    x, y = Transformer.from_crs(UTM33, 3857, always_xy=True).transform(WEST + 60, NORTH - 70)
    return tiles_of(17, (x - 250, y - 250, x + 250, y + 250), colour)


@pytest.mark.parametrize("ending", ["mbtiles", "pmtiles", "leaves.pmtiles"])
def test_tiles_are_where_they_belong(tmp_path, tiles, ending):
    path = tmp_path / f"map.{ending}"
    if ending == "mbtiles":
        write_mbtiles(path, 17, tiles)
    else:
        write_pmtiles(path, 17, tiles, leaves="leaves" in ending)
    found, kind = shown(Background(path, UTM33), AREA, (160, 200))
    assert kind == "image/jpeg"
    move = Transformer.from_crs(UTM33, 3857, always_xy=True)
    right = []
    for i, j in np.random.default_rng(0).integers(0, 160, (40, 2)).tolist():
        x, y = move.transform(AREA[0] + (j + 0.5) / 2, AREA[3] - (i + 0.5) / 2)
        expected = colour(np.array(x), np.array(y)).astype(int)[:2]
        right.append(np.abs(found[i, j, :2].astype(int) - expected).max() <= 6)  # pixels of 1.2 m, JPEG
    assert np.mean(right) > 0.9  # but where the colour begins anew


def test_a_view_of_many_tiles_takes_few(tmp_path, tiles):
    """The level follows the size of the pixels; the lowest that exists is taken, and what is not there is transparent."""
    write_mbtiles(tmp_path / "map.mbtiles", 17, tiles)
    found, kind = shown(
        Background(tmp_path / "map.mbtiles", UTM33), (WEST - 3000, NORTH - 3000, WEST + 3000, NORTH + 3000), (300, 300)
    )
    assert kind == "image/png" and 0 < (found[..., 3] > 0).mean() < 0.05


def test_of_a_view_that_is_far_too_wide_nothing_is_drawn(tmp_path, tiles):
    write_mbtiles(tmp_path / "map.mbtiles", 17, tiles)
    wide = (WEST - 100_000, NORTH - 100_000, WEST + 100_000, NORTH + 100_000)  # 400,000 tiles of the only level
    found, _ = shown(Background(tmp_path / "map.mbtiles", UTM33), wide, (50, 50))
    assert not found.any()


@pytest.mark.parametrize("share", [0.02, 0.4])
def test_cut_files_are_named(tmp_path, tiles, share):
    for name in ("map.pmtiles", "map.mbtiles", "photo.tif"):
        path = tmp_path / name
        if name == "photo.tif":
            write_geotiff(
                path, np.random.default_rng(0).integers(0, 255, (200, 200, 3), np.uint8), WEST, NORTH, 0.5, epsg=25833
            )
        else:
            (write_pmtiles if name == "map.pmtiles" else write_mbtiles)(path, 17, tiles)
        path.write_bytes(path.read_bytes()[: int(share * path.stat().st_size)])
        with pytest.raises(MlsRoadError):
            Background(path, UTM33).picture((WEST - 100, NORTH - 200, WEST + 200, NORTH + 50), (40, 40))


def test_numbers_of_tiles_are_those_of_the_format(tmp_path, tiles):
    assert [number(1, *place) for place in ((0, 0), (0, 1), (1, 1), (1, 0))] == [1, 2, 3, 4]  # of its specification
    write_pmtiles(tmp_path / "map.pmtiles", 17, tiles)
    source = PmTiles(tmp_path / "map.pmtiles")
    assert all(source.tile(17, *place) == data for place, data in tiles.items())
    column, row = next(iter(tiles))
    assert source.tile(17, column - 5, row) is None and source.tile(16, column // 2, row // 2) is None


def broken(folder, name):
    path = folder / name
    if name == "no_place.tif":
        Image.fromarray(photo(20)).save(path)
    elif name == "words.tif":
        path.write_text("no picture", encoding="ascii")
    elif name == "deep.tif":
        write_geotiff(path, np.zeros((8, 8), np.float32), WEST, NORTH, 1.0)
    elif name == "vector.mbtiles":
        write_mbtiles(path, 3, {(0, 0): b"x"}, kind="pbf")
    elif name == "words.mbtiles":
        path.write_text("no tiles", encoding="ascii")
    elif name == "short.pmtiles":
        path.write_bytes(b"PMTiles\x03")
    elif name == "photo.jp2":
        path.write_bytes(b"")
    return path


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("missing.tif", "no such file"), ("no_place.tif", "does not say where it lies"), ("words.tif", "not a TIFF"),
        ("deep.tif", "pixels of type F"), ("vector.mbtiles", "vector tiles"), ("words.mbtiles", "not an MBTiles"),
        ("short.pmtiles", "not a PMTiles"), ("photo.jp2", "a background is a GeoTIFF"),
    ],
)  # fmt: skip
def test_what_cannot_be_shown_is_named(tmp_path, name, message):
    with pytest.raises(MlsRoadError, match=f"{name}.*{message}"):
        Background(broken(tmp_path, name), UTM33)


def test_a_damaged_tile_and_a_survey_without_a_system_are_named(tmp_path, tiles):
    write_mbtiles(tmp_path / "map.mbtiles", 17, dict.fromkeys(tiles, b"no picture"))
    with pytest.raises(MlsRoadError, match="a tile of the background is damaged"):
        Background(tmp_path / "map.mbtiles", UTM33).picture(AREA, (20, 20))
    with pytest.raises(ParameterError, match="--crs"):
        Background(tmp_path / "map.mbtiles", None)


@pytest.mark.parametrize("text", ["", "1,2,3", "0,0,0,1", "0,1,1,0", "a,b,c,d", "0,0,nan,1", "0,0,1e12,1"])
def test_areas_that_are_none_are_refused(text):
    with pytest.raises(ParameterError):
        area_of(text)
    with pytest.raises(ParameterError):
        size_of("0,20" if text == "" else "20,99999")

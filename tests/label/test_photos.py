"""Photos of objects: the right image, the outline at the projected place, files linked by the number."""

import io

import numpy as np
import pandas as pd
import pytest
from PIL import Image

from mlsroad_pipeline.algorithms.cameras.camera import Camera
from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.inventory.objects.table import OBJECT_FIELDS
from mlsroad_pipeline.execution.run_folder import OutputExistsError, RunFolder
from mlsroad_pipeline.label.photos import best_view, corners_of, crop, write_photos
from mlsroad_pipeline.surveys.images import PosedImage, SurveyImages
from mlsroad_pipeline.surveys.parameters import LabelParameters

ORIGIN = np.array([391_000.0, 5_820_000.0, 30.0])
AHEAD = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # the camera looks along +y
K = [[200.0, 0, 159.5], [0, 200, 119.5], [0, 0, 1]]


def posed(name, y, time, folder, *, colour=(90, 90, 90)):
    path = folder / f"{name}.png"
    Image.new("RGB", (320, 240), colour).save(path)
    camera = Camera(K, None, AHEAD, -AHEAD @ np.array([0.0, y, 2.0]), 320, 240)
    return PosedImage(name, "front", time, camera, path)


def planted(number, x, y, **values):
    row = {name: {"float64": np.nan, "int64": 0, "str": ""}[dtype] for name, dtype in OBJECT_FIELDS.items()}
    low, high = np.array([x - 0.5, y - 0.5, 0.0]) + ORIGIN, np.array([x + 0.5, y + 0.5, 4.0]) + ORIGIN
    row |= {f"{axis}_{end}": v for end, at in (("min", low), ("max", high)) for axis, v in zip("xyz", at, strict=True)}
    return row | {"object_id": number, "kind": "pole", "class": "pole", "scene": "survey.a.scene_00000", **values}


@pytest.fixture
def images(tmp_path):
    posed_images = [
        posed("far", 0.0, 10.0, tmp_path),
        posed("near", 8.0, 11.0, tmp_path),
        posed("past", 30.0, 13.0, tmp_path),
    ]
    return SurveyImages(tuple(posed_images), ORIGIN)


def test_the_view_is_the_nearest_one_with_the_whole_object_at_the_time_of_its_points(images):
    corners, near = corners_of(planted(1, 0.0, 20.0)), [0, 1, 2]
    view = best_view(corners, images, near, (np.nan, np.nan))
    assert images[view.image].name == "near" and view.share == 1.0 and view.distance == pytest.approx(12.0)
    # half a metre left and right of the axis, 4 m high from the height of the camera -2 m, at 11.5 m
    span = 200 / 11.5
    np.testing.assert_allclose(view.outline.min(axis=0), [159.5 - 0.5 * span, 119.5 - 2 * span])
    np.testing.assert_allclose(view.outline.max(axis=0), [159.5 + 0.5 * span, 119.5 + 2 * span])
    assert images[best_view(corners, images, near, (9.0, 9.0)).image].name == "far"  # it may have moved since
    close = corners_of(planted(2, 0.0, 10.5))  # its top and foot are outside of the near image
    assert images[best_view(close, images, near, (np.nan, np.nan)).image].name == "far"
    assert best_view(corners_of(planted(3, 40.0, 20.0)), images, near, (np.nan, np.nan)) is None
    slim = corners_of(
        planted(
            4, 0.0, 20.0, footprint="POLYGON ((391000 5820020, 391000.1 5820020, 391000 5820020.1, 391000 5820020))"
        )
    )
    assert len(slim) == 6


def test_the_crop_has_the_outline_where_the_object_is_also_at_the_edge_of_the_picture():
    picture = np.full((240, 320, 3), 255, np.uint8)
    outline = np.array([[2.0, 40.0], [2.0, 150.0], [60.0, 150.0], [60.0, 40.0]])
    part = np.asarray(Image.open(io.BytesIO(crop(picture, outline, (0, 0, 0)))).convert("L")).astype(int)
    rows, columns = np.nonzero(part < 100)
    # 110 high with a margin of 35 % on both sides is 187; cut at the edge on the left
    assert part.shape == (188, 125)
    first = np.array([0, 1])
    assert columns.min() == pytest.approx(2 - first[0], abs=1.5) and columns.max() == pytest.approx(
        60 - first[0], abs=1.5
    )
    assert rows.min() == pytest.approx(40 - first[1], abs=1.5) and rows.max() == pytest.approx(150 - first[1], abs=1.5)


def test_photos_are_linked_by_number_and_replace_no_file_of_the_users(images, tmp_path):
    rows = [
        planted(7, 0.0, 20.0),
        planted(3, 1.0, 22.0),
        planted(5, 90.0, 0.0),
        planted(6, 0.0, 20.0, scene="survey.b.s"),
    ]
    objects = pd.DataFrame(rows)[list(OBJECT_FIELDS)].astype(OBJECT_FIELDS)
    run = RunFolder(str(tmp_path / "out" / ".mlsroad" / "1"))
    table = pd.read_csv(write_photos(objects, {"survey.a": images}, run))
    assert table["object_id"].tolist() == [3, 7] and table["photo"].tolist() == ["3.jpg", "7.jpg"]
    assert set(table["image"]) == {"near"} and set(table["camera"]) == {"front"}
    folder = tmp_path / "out" / "photos"
    assert sorted(path.name for path in folder.iterdir()) == ["3.jpg", "7.jpg", "photos.csv"]
    first = (folder / "7.jpg").read_bytes()
    write_photos(objects, {"survey.a": images}, run)
    assert (folder / "7.jpg").read_bytes() == first
    (folder / "7.jpg").write_bytes(b"my own photo")
    with pytest.raises(OutputExistsError, match=r"7\.jpg was written by something else"):
        write_photos(objects, {"survey.a": images}, run)
    assert (folder / "7.jpg").read_bytes() == b"my own photo"


def test_photos_need_images():
    with pytest.raises(ParameterError, match=r"label\.photos needs images: set label\.images"):
        LabelParameters("in", "out", photos=True, images=None)

"""Masks in files and their class maps."""

import struct
import zipfile
import zlib

import numpy as np
import pytest
from conftest import REPOSITORY
from helpers.yaml_files import read_yaml
from PIL import Image as Picture

from mlsroad_pipeline.algorithms.cameras.camera import Camera
from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.core.exceptions import DataError, MlsRoadError, ParameterError, ReadError
from mlsroad_pipeline.surveys.class_map_files import read_class_map
from mlsroad_pipeline.surveys.images import PosedImage, SurveyImages
from mlsroad_pipeline.surveys.masks import MaskLegend, masks_of_passes, read_mask

CAMERA = Camera([[5.0, 0, 2], [0, 5.0, 1.5], [0, 0, 1]], None, np.eye(3), np.zeros(3), 5, 4)
NUMBERS = np.array([[0, 13, 5, 255, 10]] * 4, dtype=np.uint8)


@pytest.fixture(scope="module")
def scheme():
    given = read_yaml(REPOSITORY / "conf" / "base" / "parameters_classes.yml")
    return ClassScheme.from_config("tomic2019", given["classes"]["schemes"]["tomic2019"])


@pytest.fixture(scope="module")
def known(scheme):
    return MaskLegend(read_class_map("cityscapes", scheme), scheme)


def names(known, found):
    """Name the classes of the first row of pixels."""
    return [None if np.isnan(row).any() else known.scheme.classes[row.argmax()] for row in found[0]]


READ = ["man-made terrain", "vehicle", "pole object", None, None]


@pytest.mark.parametrize("mode", ["L", "P", "I;16"])
def test_class_numbers_of_grey_palette_and_16_bit_pictures_are_read(tmp_path, known, mode):
    if mode == "I;16":
        Picture.fromarray(NUMBERS.astype(np.uint16)).save(tmp_path / "a.png")
    else:
        picture = Picture.fromarray(NUMBERS)
        if mode == "P":
            picture.putpalette([k % 256 for k in range(768)])
        picture.save(tmp_path / "a.png")
    assert names(known, read_mask(tmp_path / "a.png", CAMERA, known)) == READ


@pytest.mark.parametrize("dtype", ["float16", "float32", "float64"])
@pytest.mark.parametrize("first", [False, True])
def test_probabilities_are_read_with_channels_last_or_first(tmp_path, known, dtype, first):
    scores = np.full((4, 5, 19), 0.4 / 18)
    for column, k in enumerate([0, 13, 5, 8, 10]):
        scores[:, column, k] = 0.6
    np.savez_compressed(
        tmp_path / "a.npz", probabilities=(scores.transpose(2, 0, 1) if first else scores).astype(dtype)
    )
    found = read_mask(tmp_path / "a.npz", CAMERA, known)
    assert names(known, found)[:4] == [*READ[:3], "vegetation"] and found.sum(axis=2) == pytest.approx(np.ones((4, 5)))


def chunk(kind, data):
    """Return a chunk of a PNG."""
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def deep_palette():
    """Return a PNG with a palette and 16 bits a pixel, which the format does not have."""
    head = struct.pack(">IIBBBBB", 5, 4, 16, 3, 0, 0, 0)
    rows = zlib.compress(b"".join(b"\0" + b"\0\5" * 5 for _ in range(4)))
    parts = [chunk(b"IHDR", head), chunk(b"PLTE", bytes(48)), chunk(b"IDAT", rows), chunk(b"IEND", b"")]
    return b"\x89PNG\r\n\x1a\n" + b"".join(parts)


def grey(bits):
    """Return a PNG in grey of few bits a pixel."""
    head = struct.pack(">IIBBBBB", 5, 4, bits, 0, 0, 0, 0)
    rows = zlib.compress((b"\0" + b"\1" * -(-5 * bits // 8)) * 4)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", rows) + chunk(b"IEND", b"")


def damaged(path, what):
    """Write an NPZ and damage its data, the header of its array, or its method of compression."""
    np.savez_compressed(path, probabilities=np.full((4, 5, 19), 1 / 19))
    content = bytearray(path.read_bytes())
    start = 30 + int.from_bytes(content[26:28], "little") + int.from_bytes(content[28:30], "little")
    if what == "deflate":
        content[start : start + 8] = b"\xff" * 8
    elif what == "method":
        for place in (8, content.index(b"PK\1\2") + 10):
            content[place : place + 2] = b"\x63\0"
    else:
        with zipfile.ZipFile(path, "w") as archive:
            header = b"\x93NUMPY\1\0\x10\0" + b"{'descr': ((((((("[:16]
            archive.writestr("probabilities.npy", header)
        return
    path.write_bytes(content)


def written(path, what):
    if what == "size":
        Picture.fromarray(np.zeros((4, 6), dtype=np.uint8)).save(path)
    elif what == "number":
        Picture.fromarray(np.full((4, 5), 26011, dtype=np.uint16)).save(path)
    elif what == "colours":
        Picture.fromarray(np.zeros((4, 5, 3), dtype=np.uint8)).save(path)
    elif path.suffix == ".png":
        path.write_bytes({"deep palette": deep_palette(), "2 bits": grey(2), "4 bits": grey(4), "text": b"no"}[what])
    elif what == "sum":
        np.savez(path, probabilities=np.full((4, 5, 19), 0.5, dtype=np.float32))
    elif what == "nan":
        np.savez(path, probabilities=np.full((4, 5, 19), np.nan, dtype=np.float32))
    elif what == "classes":
        np.savez(path, probabilities=np.full((4, 5, 2), 0.5, dtype=np.float32))
    elif what == "name":
        np.savez(path, scores=np.zeros(3))
    elif what == "shape":
        np.savez(path, probabilities=np.zeros((6, 5, 19), dtype=np.float32))
    elif what == "pickle":
        np.savez(path, probabilities=np.array([{}], dtype=object))
    elif what in ("deflate", "method", "header"):
        damaged(path, what)
    else:
        path.write_bytes(b"nothing")


@pytest.mark.parametrize(
    ("what", "suffix", "told"),
    [
        ("size", "png", r"the picture has 6 x 4 pixels, the calibration is for 5 x 4"),
        ("number", "png", r"class number 26011 \(20 pixels\) is not in cityscapes"),
        ("colours", "png", r"the mask has colours \(mode RGB\)"),
        ("deep palette", "png", r"cannot be read as a picture"),
        ("text", "png", r"cannot be read as a picture"),
        ("sum", "npz", r"the probabilities of pixel row 0, column 0 sum to 9\.5 .*\(20 pixels\)"),
        ("nan", "npz", r"sum to nan"),
        ("classes", "npz", r"has 2 classes, cityscapes names 19 from 0"),
        ("name", "npz", r"holds no array 'probabilities'"),
        ("shape", "npz", r"float32 of shape \(6, 5, 19\); they must be floats of shape \(4, 5, classes\)"),
        ("pickle", "npz", r"object of shape \(1,\)"),
        ("text", "npz", r"cannot be read as NPZ"),
        ("deflate", "npz", r"cannot be read as NPZ: error: "),
        ("method", "npz", r"cannot be read as NPZ: NotImplementedError: "),
        ("header", "npz", r"cannot be read as NPZ: (TokenError|ValueError): "),
        ("2 bits", "png", r"the mask is grey of 2 bits; save .* with 8 or 16 bits, or with a palette"),
        ("4 bits", "png", r"the mask is grey of 4 bits"),
    ],
)
def test_a_bad_mask_is_one_line_with_file_and_value(tmp_path, known, what, suffix, told):
    path = tmp_path / f"a.{suffix}"
    written(path, what)
    with pytest.raises(MlsRoadError, match=rf"a\.{suffix}: .*{told}") as caught:
        read_mask(path, CAMERA, known)
    assert "\n" not in str(caught.value)


def drive(folder, *images):
    return SurveyImages(tuple(PosedImage(n, "front", 0.0, CAMERA, folder / "images" / f"{n}.jpg") for n in images))


def test_masks_lie_in_one_folder_or_beside_the_pictures_of_each_drive(tmp_path):
    for name in ("north", "south"):
        (tmp_path / name / "segmented").mkdir(parents=True)
        Picture.fromarray(NUMBERS).save(tmp_path / name / "segmented" / "i0.png")
    both = {name: drive(tmp_path / name, "i0") for name in ("north", "south")}
    found = masks_of_passes(both, "segmented")
    assert [str(images[0].path.relative_to(tmp_path)) for images in found.values()] == [
        "north/segmented/i0.png",
        "south/segmented/i0.png",
    ]
    shared = str(tmp_path / "north" / "segmented")
    assert masks_of_passes({"north": both["north"]}, shared)["north"][0].path.name == "i0.png"
    with pytest.raises(ReadError, match=r"image 'i0' occurs in passes north and south"):
        masks_of_passes(both, shared)
    with pytest.raises(ReadError, match=r"north/segmented: no mask of image 'i1': neither i1\.png nor i1\.npz"):
        masks_of_passes({"north": drive(tmp_path / "north", "i0", "i1")}, "segmented")


def test_names_with_folders_have_masks_in_the_same_folders(tmp_path):
    for camera in ("front", "rear"):
        (tmp_path / "segmented" / camera).mkdir(parents=True)
        Picture.fromarray(NUMBERS).save(tmp_path / "segmented" / camera / "0001.5.png")
    images = drive(tmp_path, "front/0001.5", "rear/0001.5")
    for folder in ("segmented", str(tmp_path / "segmented")):
        found = masks_of_passes({"north": images}, folder)["north"]
        assert [str(i.path.relative_to(tmp_path)) for i in found] == [f"segmented/{i.name}.png" for i in images]
    Picture.fromarray(NUMBERS).save(tmp_path / "segmented" / "a.png")
    with pytest.raises(ReadError, match=r"segmented/a\.png: is the mask of both images 'a\.jpg' and 'a\.png'"):
        masks_of_passes({"north": drive(tmp_path, "a.jpg", "a.png")}, "segmented")


def test_class_maps_are_read_from_csv_and_yaml(tmp_path, scheme):
    (tmp_path / "a.csv").write_text("number, name, class\n1, street, road\n0, unknown,\n")
    (tmp_path / "a.yml").write_text("0: null\n1: {name: street, class: man-made terrain}\n")
    for name in ("a.csv", "a.yml"):
        legend = read_class_map(str(tmp_path / name), scheme)
        assert legend.numbers == (0, 1) and legend.labels(scheme).tolist() == [-1, 0] and legend.names[1] == "street"
    assert read_class_map("scheme", scheme).names[-1] == "sky"
    assert read_class_map("cityscapes", scheme).n_scores == 19


@pytest.mark.parametrize(
    ("name", "text", "told"),
    [
        ("a.csv", "id,class\n0,road\n", r"no column 'number' among \['id', 'class'\]"),
        ("a.csv", "number,class\nx,road\n", r"class number 'x' is not a whole number"),
        ("a.csv", "number,name,class\n0,road\n", r"line 2 has not the 3 columns"),
        ("a.csv", "number,class\n0,street\n", r"'street' is neither a class of scheme 'tomic2019' nor"),
        ("a.yml", "- road\n", r"must map class numbers to classes"),
        ("a.yml", "- sidewalk\n" * 9, r"not \['sidewalk', .*'sid\.\.\.$"),
        ("a.yml", "0: [road]\n", r"class number 0 has \['road'\]"),
        ("a.yml", "0: {\n", r"not YAML"),
        ("a.yml", "0: road\n1: car\n0: tree\n", r"a\.yml: class number 0 is repeated"),
        ("a.yml", "1: road\n0x1: tree\n", r"a\.yml: class number 1 is repeated"),
        ("a.csv", "number,class\n0,road\n0,tree\n", r"a\.csv: class number 0 is repeated"),
        ("a.txt", "", r"name asprs, cityscapes, mlsroad, paris_lille3d, scheme, toronto3d, or a file"),
    ],
)
def test_class_maps_that_are_wrong_are_named(tmp_path, scheme, name, text, told):
    (tmp_path / name).write_text(text)
    with pytest.raises((ReadError, ParameterError, DataError), match=told):
        read_class_map(str(tmp_path / name), scheme)
    with pytest.raises(ReadError, match="no such class map"):
        read_class_map(str(tmp_path / "none.csv"), scheme)


def test_the_home_folder_is_expanded(tmp_path, monkeypatch, scheme):
    monkeypatch.setenv("HOME", str(tmp_path))
    (tmp_path / "m").mkdir()
    Picture.fromarray(NUMBERS).save(tmp_path / "m" / "i0.png")
    found = masks_of_passes({"d": drive(tmp_path / "d", "i0")}, "~/m")["d"]
    assert [image.path for image in found] == [tmp_path / "m" / "i0.png"]
    (tmp_path / "c.csv").write_text("number,class\n0,road\n")
    assert read_class_map("~/c.csv", scheme).source == str(tmp_path / "c.csv")

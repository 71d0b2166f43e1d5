"""Every public recording, read with what the environments ship: counts by another way, and the right columns."""

import gzip
from pathlib import Path

import numpy as np
import pytest
from helpers.yaml_files import read_yaml

from mlsroad_pipeline.formats.base import ReadOptions
from mlsroad_pipeline.formats.registry import get_format

CONF = Path(__file__).resolve().parents[2] / "conf"
LAS_1_2 = {
    *("intensity", "return_number", "number_of_returns", "scan_direction_flag", "edge_of_flight_line", "user_data"),
    *("classification", "synthetic", "key_point", "withheld", "scan_angle_rank", "point_source_id", "gps_time"),
}
OBJECT = {"gps_time", "intensity", "id", "azimuth", "range", "pid"}
FOLDERS = {  # environment, files, their number, their points, columns
    "amsterdam": ("base", "*.laz", 1, 454_236, LAS_1_2 | {"rgb", "rgb16", "label"}),
    "jakarto": ("base", "*.las", 1, 10_310, LAS_1_2),
    "sustech": ("base", "*.pcd", 1, 66_781, {"intensity", "gps_time", "ring"}),
    "kitti_painted": ("base", "*.bin", 8, 957_856, {"intensity"}),
    "semantickitti": ("semantickitti", "*.bin", 1, 123_389, {"intensity", "label", "instance"}),
    "oakland": ("oakland", "*.xyz_label_conf.gz", 11, 1_073_799, {"label", "confidence"}),
    "isprs": ("isprs", "*.txt", 1, 38_010, {"label"}),
    "taiwan_poles": ("taiwan_poles", "*.csv.gz", 57, 595_169, {"intensity"}),
    "sydney/objects": ("sydney", "*.bin", 433, 211_315, OBJECT),
}
RECORD_SIZES = {"kitti_painted": 16, "semantickitti": 16, "sydney/objects": 34}


def read_options(env):
    """Give the options of a shipped environment, those of the base where it has none of its own."""
    path = CONF / env / ("parameters_survey.yml" if env == "base" else "parameters.yml")
    return ReadOptions.from_config(read_yaml(path).get("survey", {}).get("read"))


def counted(path, folder):
    """Count points without reading them: by the size of the file, or by its lines."""
    if folder in RECORD_SIZES:
        return path.stat().st_size / RECORD_SIZES[folder]
    if path.suffix in (".las", ".laz"):
        return int.from_bytes(path.read_bytes()[107:111], "little")
    data = gzip.decompress(path.read_bytes()) if path.suffix == ".gz" else path.read_bytes()
    return sum(1 for line in data.splitlines() if line.strip() and not line.startswith(b"#"))


@pytest.mark.real_data
@pytest.mark.parametrize("folder", FOLDERS)
def test_every_recording_is_read_by_a_shipped_environment(real_data, folder):
    env, pattern, n_files, n_points, columns = FOLDERS[folder]
    paths = sorted(real_data(*folder.split("/")).glob(pattern))
    assert len(paths) == n_files
    options = read_options(env)
    total = 0
    for number, path in enumerate(paths):
        form = get_format(path)
        info = form.info(path, options)
        total += info.n_points
        if pattern != "*.pcd":  # which holds beams without return
            assert info.n_points == counted(path, folder), path
        if number % 10 == 0:
            cloud = form.read(path, options)
            assert len(cloud) == info.n_points
            own = {name for name in cloud.columns if not name.startswith("column_")}
            assert own == columns, path
            assert {name: values.dtype for name, values in cloud.columns.items()} == dict(info.columns)
    assert total == n_points


@pytest.mark.real_data
def test_units_and_labels_of_the_environments(real_data):
    pole = get_format(path := real_data("taiwan_poles", "b.csv.gz")).read(path, read_options("taiwan_poles"))
    first = [float(value) for value in gzip.decompress(path.read_bytes()).split(b"\n")[0].split(b",")]
    np.testing.assert_allclose(pole.world_xyz()[0], np.array(first[:3]) / 1000)  # millimetres
    assert pole["intensity"][0] == np.float32(first[3] / 65535) and np.ptp(pole.xyz[:, 2]) < 30
    patch = get_format(path := real_data("isprs", "samp11.txt")).read(path, read_options("isprs"))
    assert set(np.unique(patch["label"]).tolist()) == {0, 1} and patch["label"].dtype == np.int32
    painted = get_format(path := real_data("kitti_painted", "000000_painted.bin"))
    classes = painted.read(path, ReadOptions(columns={"label": "intensity"}))  # Cityscapes' train ids
    assert set(np.unique(classes["label"]).tolist()) <= {*range(19), 255}
    text, packed = (real_data("sydney", "objects", f"4wd.0.2299.{kind}") for kind in ("csv", "bin"))
    one, other = (get_format(path).read(path, ReadOptions()) for path in (text, packed))
    assert get_format(text).name == "Sydney" and len(one) == len(other)
    np.testing.assert_allclose(one.xyz, other.xyz, rtol=0, atol=1e-4)

"""Tables of true objects: tables of users, simulated streets, PandaSet, KITTI and SemanticKITTI, and wrong ones."""

import numpy as np
import pandas as pd
import pytest
import shapely

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY
from mlsroad_pipeline.algorithms.core.exceptions import DataError, ReadError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.formats.base import WriteOptions
from mlsroad_pipeline.formats.las.format import LasFormat
from mlsroad_pipeline.surveys.truth_tables import Truth, counted_objects, instances_of_objects, point_counts, read_truth


def written(folder, text, name="truth.csv"):
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
    return path


def test_a_table_of_a_user(tmp_path):
    truth = read_truth(written(tmp_path, "kind,x,y,height,counted\npole,1,2,,true\nsign,3,4,2.5,False\n"))
    assert truth.source == "table" and truth.region is None
    assert truth.objects["counted"].tolist() == [True, False]
    assert truth.objects["height"].tolist() == pytest.approx([np.nan, 2.5], nan_ok=True)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("kind,x\npole,1\n", "needs the column y .has kind, x."),
        ("kind,x,y\npole,here,2\n", "column x has 'here' in row 1: it is not a number"),
        ("kind,x,y\npole,1,2\npole,,2\n", "column x has an empty cell in row 2"),
        ("kind,x,y,counted\npole,1,2,perhaps\n", "column counted has 'perhaps' in row 1: write true or false"),
        ("kind,x,y\npole,1,2\nlamp,3,4\n", "column kind has 'lamp' in row 2: kinds are pole, sign, vehicle, tree"),
        ("kind;x;y\npole;1,5;2\nsign;x;3\n", "column x has 'x' in row 2: it is not a number"),
        ("kind,x,y\n", "the table has no true objects"),
        ("", "not a table of objects"),
    ],
)
def test_a_wrong_table_is_one_error_with_file_and_value(tmp_path, text, said):
    path = written(tmp_path, text)
    with pytest.raises((DataError, ReadError), match=said) as caught:
        read_truth(path)
    assert str(path) in str(caught.value)


def test_semicolons_and_decimal_commas_of_spreadsheets(tmp_path):
    truth = read_truth(written(tmp_path, "\ufeffkind;x;y;height\nPole;389270,5;5819690,25;\nsign;3;4;2,5\n"))
    assert truth.objects["kind"].tolist() == ["pole", "sign"]
    assert truth.objects[["x", "y"]].to_numpy().tolist() == [[389270.5, 5819690.25], [3.0, 4.0]]
    assert truth.objects["height"].iloc[1] == 2.5
    points = read_truth(written(tmp_path, "kind;x;y\npole;1.5;2\n"))
    assert points.objects["x"].tolist() == [1.5]


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(ReadError, match=r"nowhere\.csv does not exist"):
        read_truth(tmp_path / "nowhere.csv")


SIMULATED = {
    "instance": [7, 8, 9], "label": [TAXONOMY["car"], TAXONOMY["traffic_sign"], TAXONOMY["car"]], "x": [0.0, 10.0, 50.0],
    "y": [0.0, 0.0, 0.0], "z": [1.0, 1.0, 1.0], "moving": [False, False, True], "design": ["sedan", "plate", "sedan"],
    "length": [4.5, 0.7, 4.5], "width": [1.9, 0.1, 1.9], "height": [1.5, 3.0, 1.5], "heading": [np.pi / 2, 0.0, 0.0],
    "box_x": [0.5, 10.0, 50.5], "box_y": [0.0, 0.0, 0.0], "panel_x": [np.nan, 10.2, np.nan],
    "panel_y": [np.nan, 0.0, np.nan], "panel_azimuth": [np.nan, 90.0, np.nan],
}  # fmt: skip


def test_a_simulated_street_has_places_and_points_of_its_clouds(tmp_path):
    pd.DataFrame(SIMULATED).to_csv(tmp_path / "objects.csv", index=False)
    truth = read_truth(tmp_path)
    assert truth.objects["kind"].tolist() == ["vehicle", "sign", "vehicle"]
    assert truth.objects["x"].tolist() == [0.5, 10.2, 50.5]
    assert truth.objects["heading"].tolist() == pytest.approx([0.0, np.nan, 90.0], nan_ok=True)
    assert truth.objects["counted"].tolist() == [True, True, False]
    cloud = PointCloud(np.zeros((12, 3)), {"instance": np.array([7] * 9 + [8] * 3, np.int32)})
    LasFormat().write(tmp_path / "labelled.laz", cloud, WriteOptions(like="none"))
    counts = point_counts(truth, [tmp_path / "labelled.laz"])
    assert counts.tolist() == [9, 3, 0]
    assert counted_objects(truth, counts, {"vehicle": 9, "sign": 4})["counted"].tolist() == [True, False, False]
    assert point_counts(truth, []) is None


def test_a_plate_on_a_lamp_is_a_sign_that_does_not_count(tmp_path):
    table = pd.DataFrame(SIMULATED)
    lamp = table.iloc[1].to_dict() | {"label": TAXONOMY["light_pole"], "design": "lamp_with_sign", "instance": 9}
    pd.concat([table, pd.DataFrame([lamp])]).to_csv(tmp_path / "objects.csv", index=False)
    objects = read_truth(tmp_path).objects
    assert objects["kind"].tolist() == ["vehicle", "sign", "vehicle", "pole", "sign"]
    assert objects[["instance", "x", "counted"]].iloc[3:].values.tolist() == [[9, 10.0, True], [9, 10.2, False]]
    assert objects["name"].iloc[4] == "plate on light_pole lamp_with_sign"


def test_the_true_object_of_a_listed_one_has_more_than_half_of_its_points(tmp_path):
    pd.DataFrame(SIMULATED).to_csv(tmp_path / "objects.csv", index=False)
    truth = read_truth(tmp_path)
    columns = {
        "object_id": np.array([1, 1, 1, 2, 2, 0, 3], np.uint32), "instance": np.array([7, 7, 8, 8, 9, 7, 9], np.int32)
    }  # fmt: skip
    for name, part in (("a.laz", slice(0, 4)), ("b.laz", slice(4, 7))):
        own = {key: values[part] for key, values in columns.items()}
        cloud = PointCloud(np.zeros((len(own["instance"]), 3)), own)
        LasFormat().write(tmp_path / name, cloud, WriteOptions(like="none"))
    assert instances_of_objects(truth, [tmp_path / "a.laz", tmp_path / "b.laz"]).to_dict() == {1: 7, 3: 9}
    assert instances_of_objects(truth, []).empty


def test_boxes_of_pandaset(tmp_path):
    text = (
        "label,yaw,stationary,position.x,position.y,position.z,dimensions.x,dimensions.y,dimensions.z,"
        "cuboids.sibling_id,cuboids.sensor_id\n"
        "Car,0.0,True,1,2,3,2,4,1.5,-,-1\nCar,0.1,True,1,2,3,2,4,1.5,abc,1\nBus,0.5,False,9,9,3,3,12,3,-,-1\n"
        "Pedestrian,0.5,False,9,9,3,1,1,2,-,-1\n"
    )
    truth = read_truth(written(tmp_path, text))
    assert truth.objects["counted"].tolist() == [True, False]
    car = truth.objects.iloc[0]
    assert (car["length"], car["width"], car["z"], car["heading"]) == (4.0, 2.0, 2.25, 0.0)
    assert truth.objects["heading"].iloc[1] == pytest.approx(180.0 - np.degrees(0.5))
    rng = np.random.default_rng(0)
    inside = rng.uniform([-1.0, -2.0, 0.2], [1.0, 2.0, 1.5], (50, 3)) + [1, 2, 2.25]
    LasFormat().write(
        tmp_path / "a.laz", PointCloud(np.concatenate([inside, [[1, 6.5, 3]]]), {}), WriteOptions(like="none")
    )
    assert point_counts(truth, [tmp_path / "a.laz"]).tolist() == [50, 0]


IDENTITY = "R0_rect: 1 0 0 0 1 0 0 0 1\nTr_velo_to_cam: 0 -1 0 0 0 0 -1 0 1 0 0 0\n"


def test_boxes_of_kitti_hold_in_the_view_of_the_camera(tmp_path):
    calibration = "P2: 700 0 600 0 0 700 180 0 0 0 1 0\n" + IDENTITY
    written(tmp_path, calibration, "calib/000001.txt")
    text = (
        "Car 0 0 0 1 2 3 4 1.5 1.6 4.0 2.0 1.7 20.0 1.57\n"
        "Pedestrian 0 0 0 1 2 3 4 1.8 0.5 0.5 2.0 1.7 20.0 0\n"
        "DontCare -1 -1 -10 500 100 600 200 -1 -1 -1 -1000 -1000 -1000 -10\n"
    )
    truth = read_truth(written(tmp_path, text, "label_2/000001.txt"))
    car = truth.objects.iloc[0]
    assert (len(truth.objects), car["x"], car["y"], car["z"]) == (1, 20.0, -2.0, -1.7)
    assert car["heading"] == pytest.approx(
        np.degrees(1.57)
    )  # to the side of the camera at 0, ahead of it at 90 degrees
    assert shapely.contains_xy(truth.region, [20.0, 20.0, -5.0, 20.0], [-2.0, 30.0, 0.0, 1.0]).tolist() == [
        True, False, False, False,
    ]  # fmt: skip
    with pytest.raises(ReadError, match=r"calib.000002\.txt does not exist"):
        read_truth(written(tmp_path, text, "label_2/000002.txt"))


def test_instances_of_semantickitti(tmp_path):
    rng = np.random.default_rng(0)
    car = rng.uniform([-2.0, -0.9, 0.0], [2.0, 0.9, 1.5], (400, 3)) + [10, 5, -1.7]
    xyz = np.concatenate([car, car + [10, 0, 0], [[0.0, 0, 0]]])
    np.column_stack([xyz, np.zeros(801)]).astype("<f4").tofile(tmp_path / "000000.bin")
    packed = np.concatenate([np.full(400, (3 << 16) + 10), np.full(400, (4 << 16) + 252), [40]]).astype("<u4")
    packed.tofile(tmp_path / "000000.label")
    truth = read_truth(tmp_path / "000000.label")
    assert truth.objects["counted"].tolist() == [True, False]
    assert truth.objects["points"].tolist() == [400, 400]
    assert truth.objects[["x", "y"]].to_numpy() == pytest.approx(np.array([[10.0, 5], [20, 5]]), abs=0.05)
    packed[:7].tofile(tmp_path / "000000.label")
    with pytest.raises(DataError, match="has 7 labels for the 801 points"):
        read_truth(tmp_path / "000000.label")


def test_tables_without_boxes_and_instances_count_all():
    truth = Truth(pd.DataFrame({"kind": ["pole"], "x": [0.0], "y": [0.0], "counted": [True]}), None, "table")
    assert counted_objects(truth, point_counts(truth, []), {})["counted"].all()

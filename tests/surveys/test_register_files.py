"""Registers of each format, their columns, kinds and places, and errors."""

import geopandas as gpd
import pandas as pd
import pytest
import shapely

from mlsroad_pipeline.algorithms.core.exceptions import DataError, MlsRoadError, ParameterError
from mlsroad_pipeline.surveys.register_files import RegisterFile

UTM = "EPSG:25833"
ROWS = {"nr": ["A1", "A2", "A3"], "type": ["Mast", "Tree", "Hut"], "e": [389300.5, 389310.25, 389320.0]}
ROWS |= {"n": [5819700.0, 5819710.5, 5819720.0], "h": [5.5, 9.0, None]}
NAMES = {"id": "nr", "kind": "type", "x": "e", "y": "n", "height": "h"}
KINDS = {"Mast": "pole", "Hut": "-"}


def check(entries, tolerance=0.001):
    assert entries["id"].tolist() == ["A1", "A2"] and entries["kind"].tolist() == ["pole", "tree"]
    assert entries["x"].tolist() == pytest.approx(ROWS["e"][:2], abs=tolerance)
    assert entries["y"].tolist() == pytest.approx(ROWS["n"][:2], abs=tolerance)
    assert entries["height"].tolist() == pytest.approx([5.5, 9.0])


@pytest.mark.parametrize("text", [dict(sep=","), dict(sep=";", decimal=",")])
def test_tables_are_read_by_named_columns(tmp_path, text):
    path = tmp_path / "register.csv"
    pd.DataFrame(ROWS).to_csv(path, index=False, **text)
    check(RegisterFile(path, NAMES, KINDS).read(UTM))


@pytest.mark.parametrize("name", ["register.gpkg", "register.shp", "register.geojson"])
@pytest.mark.parametrize("area", [False, True])
def test_features_have_places_in_the_system_of_the_survey(tmp_path, name, area):
    points = gpd.GeoSeries(shapely.points(ROWS["e"], ROWS["n"]), crs=UTM)
    shapes = points.buffer(2.0) if area else points
    frame = gpd.GeoDataFrame({key: ROWS[key] for key in ("nr", "type", "h")}, geometry=shapes)
    frame.to_crs("EPSG:4326").to_file(tmp_path / name)
    names = {key: value for key, value in NAMES.items() if key not in "xy"}
    check(RegisterFile(tmp_path / name, names, KINDS).read(UTM), tolerance=0.02)


def test_a_register_of_one_kind_needs_places_alone(tmp_path):
    path = tmp_path / "lamps.csv"
    path.write_text("x,y\n1,2\n3,4\n")
    entries = RegisterFile(path, kind="pole").read(None)
    assert entries["kind"].tolist() == ["pole", "pole"] and entries["id"].tolist() == [1, 2]
    assert entries["height"].isna().all()


@pytest.mark.parametrize(
    ("text", "options", "message"),
    [
        ("x,y\n1,2\n", {}, r"no column 'kind' \(has x, y\): name it with --column kind=NAME"),
        ("kind,x\npole,2\n", {}, r"no column 'y'.*--column y=NAME"),
        ("kind,x,y\x1b[31m\npole,1,2\n", {}, r"\(has kind, x, y\\x1b\[31m, "),
        ("kind,x,y\npole,a,2\n", {}, r"column x has 'a' in row 1"),
        ("kind,x,y\npole,1,2\n,1,2\n", {}, "entry 2 has no kind: fill it in, or remove it"),
        ("kind,x,y\nMast,1,2\nvehicle,1,2\n", {"kinds": {"Mast": "pole"}}, "unknown kinds vehicle"),
        ("kind,x,y\nMast,1,2\nHut,1,2\n", {}, r"unknown kinds Hut, Mast: give each a kind, such as --value 'Hut=pole'"),
        ("kind,x,y\npole,1,2\n", {"columns": {"height": "h"}}, r"no column 'h' \(has kind, x, y\)"),
        ("kind,x,y\nHut,1,2\n", {"kinds": {"Hut": "-"}}, "the register has no entries"),
        ("", {}, "not a table of objects"),
    ],
)
def test_wrong_tables_are_named_with_their_value(tmp_path, text, options, message):
    path = tmp_path / "register.csv"
    path.write_text(text)
    with pytest.raises(DataError, match=rf"register\.csv.*{message}"):
        RegisterFile(path, **options).read(None)


def test_wrong_options_and_files_are_named(tmp_path):
    for options, message in (
        ({"columns": {"colour": "c"}}, "--column colour: unknown column"),
        ({"kinds": {"Mast": "mast"}}, "kind 'mast' of Mast: unknown kind"),
        ({"kind": "lamp"}, "kind 'lamp' of --kind: unknown kind"),
    ):
        with pytest.raises(ParameterError, match=message):
            RegisterFile(tmp_path / "r.csv", **options)
    (tmp_path / "r.gpkg").write_text("no")
    for name, message in (("none.csv", "does not exist"), ("r.gpkg", "cannot be read")):
        with pytest.raises(MlsRoadError, match=message):
            RegisterFile(tmp_path / name).read(None)


def test_one_of_several_layers_must_be_named(tmp_path):
    path = tmp_path / "r.gpkg"
    for layer in ("a", "b"):
        gpd.GeoDataFrame({"kind": ["pole"]}, geometry=[shapely.Point(1, 2)], crs=UTM).to_file(path, layer=layer)
    with pytest.raises(DataError, match=r"has layers a, b: name one with --layer"):
        RegisterFile(path).read(UTM)
    assert len(RegisterFile(path, layer="b").read(UTM)) == 1
    with pytest.raises(DataError, match=r"has no layer 'c' \(--layer\): it has a, b"):
        RegisterFile(path, layer="c").read(UTM)

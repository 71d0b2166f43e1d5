"""Inventories in layers, fields and codes of a user: the examples of the manual, and errors that name the place."""

import re

import geopandas
import pyogrio
import pytest
from helpers.inventories import planted_inventory
from helpers.wiring import REPOSITORY

from mlsroad_pipeline.algorithms.core.exceptions import MlsRoadError
from mlsroad_pipeline.inventory_files.own_schema import DRIVERS, read_schema, write_own_schema

PAGE = (REPOSITORY / "docs/how_to/deliver.md").read_text(encoding="utf-8")
EXAMPLES = re.findall(r"```yaml\n(layers:.*?)```", PAGE, re.DOTALL)


def schema(tmp_path, text):
    path = tmp_path / "schema.yml"
    path.write_text(text, encoding="utf-8")
    return read_schema(path)


def test_the_examples_of_the_manual_give_their_layers(tmp_path):
    roads, city, imgeo, drive = (schema(tmp_path, text) for text in EXAMPLES)
    [path] = write_own_schema(planted_inventory(), roads, tmp_path / "a.gpkg")
    masts = geopandas.read_file(path, layer="Mast")
    assert masts.drop(columns="geometry").to_dict("records") == [
        {"Nummer": 1, "Station": 12.5, "Abstand": -3.25, "Hoehe": 2.5, "Art": 3, "Herkunft": "MLS"}
    ]
    assert geopandas.read_file(path, layer="Bordstein").geom_type.tolist() == ["LineString"]
    assert pyogrio.read_info(path, layer="Mast")["crs"] == "EPSG:25833"
    names = [path.name for path in write_own_schema(planted_inventory(), city, tmp_path / "b.csv")]
    assert names == ["b_SolitaryVegetationObject.csv", "b_CityFurniture.csv"]
    [path] = write_own_schema(planted_inventory(), imgeo, tmp_path / "imgeo.gpkg")
    assert geopandas.read_file(path, layer="Paal")["plus-type"].tolist() == ["lichtmast"]
    assert geopandas.read_file(path, layer="Bord")["plus-type"].unique().tolist() == ["verkeersbord"]
    assert pyogrio.read_dataframe(tmp_path / names[1])["class"].astype(int).tolist() == [1010, 1000, 1000]
    names = [path.name for path in write_own_schema(planted_inventory(), drive, tmp_path / "c.gml")]
    assert names == ["c_object.gml", "c_object.xsd", "c_signal.gml", "c_signal.xsd"]
    [pole] = pyogrio.read_dataframe(tmp_path / "c_object.gml").drop(columns=["gml_id", "geometry"]).to_dict("records")
    assert pole == {"id": 1, "type": "pole", "s": 12.5, "t": 3.25, "height": 2.5}


@pytest.mark.parametrize("suffix", DRIVERS)
def test_every_format_has_the_rows_and_shapes_of_the_kind(tmp_path, suffix):
    layers = schema(tmp_path, "layers: {Autos: {kind: vehicle, fields: {nr: object_id, hoch: height}}}")
    written = write_own_schema(planted_inventory(), layers, tmp_path / f"x{suffix}")
    found = pyogrio.read_dataframe(next(path for path in written if path.suffix == suffix))
    assert found[["nr", "hoch"]].astype(float).to_numpy().tolist() == [[5.0, 12.5]]
    assert found.geometry.geom_type.tolist() == ["Polygon"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("layers: [", "schema.yml is not YAML"),
        ("layer: {}", "schema.yml: needs 'layers', each with 'kind' and 'fields'"),
        ("layers: {A: {kind: lamp, fields: {a: x}}}", "layer 'A': unknown kind 'lamp': use one of pole, sign"),
        ("layers: {A: {kind: pole}}", "layer 'A': needs 'fields'"),
        ("layers: {A: {kind: pole, fields: {a: length}}}", "layer 'A', field 'a': pole has no 'length': use object_id"),
        ("layers: {A: {kind: pole, fields: {a: {from: class}}}}", "field 'a': needs 'codes'"),
        ("layers: {A: {kind: pole, fields: {a: {from: class, codes: {x: 1}}}}}", "no code for class 'pole': add it"),
        ("layers: {A/b: {kind: pole, fields: {a: x}}}", "layer 'A/b': the name of a layer is part of a file name"),
        ("layers: {../A: {kind: pole, fields: {a: x}}}", "layer '../A': the name of a layer is part of a file name"),
        ("layers: {A: {kind: pole, fields: {a: x, A: y}}}", "field 'a': this name is taken"),
        ("layers: {A: {kind: pole, fields: {Geometry: x}}}", "field 'geometry': this name is taken"),
        ("layers: {A: {kind: pole, fields: {a: {form: class}}}}", "field 'a': has form: use value, or from and codes"),
        (
            "layers: {A: {kind: pole, fields: {a: {from: x, factor: m}}}}",
            "factor is a number, beside from alone, got 'm'",
        ),
        (
            "layers: {A: {kind: pole, fields: {a: {from: note, factor: 2}}}}",
            "field 'a': note is text, which has no factor",
        ),
        ("layers: {A: {kind: pole, fields: {a_long_name: x}}}", "'a_long_name' has more than 10 characters"),
    ],
)
def test_mistakes_are_one_line_that_names_the_place(tmp_path, text, message):
    with pytest.raises(MlsRoadError) as caught:
        write_own_schema(planted_inventory(), schema(tmp_path, text), tmp_path / "x.shp")
    assert message in str(caught.value) and "\n" not in str(caught.value)
    assert not list(tmp_path.glob("x*"))


def test_drawings_have_no_schema(tmp_path):
    layers = schema(tmp_path, "layers: {A: {kind: pole, fields: {a: x}}}")
    with pytest.raises(MlsRoadError, match="x.dxf: a schema of your own is written as .gpkg, .csv"):
        write_own_schema(planted_inventory(), layers, tmp_path / "x.dxf")

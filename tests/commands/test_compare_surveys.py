"""The command `mlsroad compare` on two surveys of a simulated street, listed from their true classes."""

import shutil
from dataclasses import replace

import geopandas as gpd
import numpy as np
import pandas as pd
import pytest
from helpers.forking import ALONE
from helpers.labelled import write_true_classes
from PIL import Image

from mlsroad_pipeline.simulation import PRESETS, another_year
from mlsroad_pipeline.simulation.parameters.street_parameters import StreetParameters
from mlsroad_pipeline.surveys.simulated import write_simulated_survey

OFFSET = np.array([0.25, -0.15, 0.1])


@pytest.fixture(scope="module")
def folder(run, tmp_path_factory):
    """Inventories of a street and of the same street in another year, with an offset."""
    place = tmp_path_factory.mktemp("compared")
    kind = StreetParameters(lamp_spacing=12.0, signs=3.0, parked=0.2)
    sparse = {"length": 30.0, "pulse_rate": 25_000.0, "profile_rate": 60.0, "with_images": False}
    first = replace(PRESETS["small"], seed=72, street=kind, **sparse)
    for name, parameters in (("first", first), ("later", another_year(first, 2, offset=tuple(OFFSET)))):
        write_simulated_survey(parameters=parameters, folder=str(place / name), n_threads=1)
        write_true_classes(place / name / "survey.laz")
        done = run("inventory", name, "--class-map", "mlsroad", *ALONE, cwd=place)
        assert done.returncode == 0, done.stderr
    return place


@pytest.fixture(scope="module")
def compared(run, folder):
    done = run("compare", "first", "later_mlsroad", "--align", cwd=folder)
    assert done.returncode == 0, done.stderr
    return done


def table_of(path):
    return pd.read_csv(path / "changes.csv").fillna({"changes": ""})


def test_changes_are_those_of_the_simulator(folder, compared):
    table = table_of(folder / "later_mlsroad/changes")
    before, after = (pd.read_csv(folder / name / "objects.csv").set_index("instance") for name in ("first", "later"))
    for end, truth, other, shift in (("first", before, after, OFFSET), ("second", after, before, 0 * OFFSET)):
        one_sided = table[table["state"] == ("gone" if end == "first" else "new")]
        for row in one_sided.to_dict("records"):
            near = truth[np.hypot(truth["x"] + shift[0] - row["x"], truth["y"] + shift[1] - row["y"]) < 1]
            away = near.index.difference(other.index)
            both = near.index.intersection(other.index)
            way = np.hypot(
                *(after.loc[both, ["x", "y"]] - before.loc[both, ["x", "y"]]).to_numpy().T - OFFSET[:2, None]
            )
            assert len(away) or (way > 1).any(), row
    assert (table["state"] == "unchanged").sum() > 5 and table["state"].isin(("gone", "new", "moved")).any()
    assert table["key"].is_unique and (table["key"].str.len() == 36).all()
    matched = table[(table["first_id"] > 0) & (table["second_id"] > 0) & (table["state"] == "unchanged")]
    assert matched["distance"].median() < 0.1


def test_the_offset_is_measured_and_removed(folder, compared):
    text = " ".join(compared.stdout.split())
    found = text.partition("Offset of the later survey: ")[2].split(" m in ")
    values = [float(part.split()[-1]) for part in found[:3]]
    assert values == pytest.approx(OFFSET, abs=0.05) and "the earlier survey was moved by it" in text


def test_layers_raster_and_page_are_written(folder, compared):
    place = folder / "later_mlsroad/changes"
    table, layer = table_of(place), gpd.read_file(place / "changes.gpkg", layer="objects")
    assert layer["state"].tolist() == table["state"].tolist() and layer.crs is not None
    lines, drawn = pd.read_csv(place / "changed_lines.csv"), gpd.read_file(place / "changes.gpkg", layer="lines")
    assert (
        drawn["state"].tolist() == lines["state"].tolist() and (drawn.geometry.length >= lines["length"] - 0.01).all()
    )
    one_sided = lines[lines["state"].isin(("new", "gone"))]  # the simulator changes no line
    assert lines["length"].sum() > 50 and one_sided["length"].sum() <= 0.05 * lines["length"].sum()
    assert "line [m]" in compared.stdout
    areas = gpd.read_file(place / "changes.gpkg", layer="surfaces")
    assert set(areas["surface"]) <= {"road", "kerb", "facade"} and (areas.geometry.area > 0).all()
    with Image.open(place / "surface_change.tif") as image:
        values = np.asarray(image)
    assert np.nanmedian(np.abs(values)) < 0.02 and np.isfinite(values).sum() > 500
    page = (place / "changes.html").read_text()
    assert "Changes from first_mlsroad to later_mlsroad" in page and page.count("<figure>") >= 1 and 'id="map"' in page
    assert str(table.loc[0, "key"]) in page


def test_nothing_moves_unless_asked_and_keys_are_lasting(run, folder, compared):
    done = run("compare", "later_mlsroad", "first_mlsroad", "--no-surfaces", "-o", "back", cwd=folder)
    assert done.returncode == 0, done.stderr
    assert "nothing was moved" in " ".join(done.stdout.split()) and not (folder / "back/surface_change.tif").exists()
    first, back = table_of(folder / "later_mlsroad/changes"), table_of(folder / "back")
    same = back[(back["state"] == "unchanged") & (back["second_id"] > 0) & (back["first_id"] > 0)]
    assert same["distance"].median() == pytest.approx(np.hypot(*OFFSET[:2]), abs=0.05)
    keys = dict(zip(first["second_id"], first["key"], strict=True))
    assert len(same) > 5 and all(
        keys[number] == key for number, key in same[["first_id", "key"]].itertuples(index=False)
    )


def test_changes_are_not_replaced_unasked(run, folder, compared):
    again = run("compare", "first", "later_mlsroad", "--no-surfaces", cwd=folder)
    assert again.returncode == 1 and "holds the changes of two surveys" in again.stderr


@pytest.mark.parametrize("name", ["changes.csv", "changes.gpkg"])
def test_files_of_the_user_are_not_replaced(run, folder, name):
    place = folder / f"own_{name}"
    place.mkdir()
    (place / name).write_text("street,change\nA,new kerb\n")
    done = run("compare", "first", "later_mlsroad", "--no-surfaces", "--overwrite", "-o", place.name, cwd=folder)
    assert done.returncode == 1 and f"{place.name}/{name} does not hold changes of two surveys" in done.stderr
    assert (place / name).read_text() == "street,change\nA,new kerb\n" and len(list(place.iterdir())) == 1


def test_numbers_are_rounded_and_every_object_has_a_reason(folder, compared):
    text = pd.read_csv(folder / "later_mlsroad/changes/changes.csv", dtype=str, keep_default_na=False)
    numbers = text.drop(columns=["key", "changes", "reason"]).to_numpy().ravel()
    assert max(len(value.partition(".")[2]) for value in numbers) <= 3
    assert (text["reason"] != "").all()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("first_mlsroad", "first_mlsroad"), "first_mlsroad is named twice"),
        (("first_mlsroad", "later_mlsroad", "--kind", "pole", "-o", "x"), "--kind is for a register"),
        (("register.csv", "later_mlsroad", "--align"), "--align is for two surveys"),
        (("empty", "later_mlsroad", "-o", "x"), "holds no finished results of label"),
        (("new.laz", "later_mlsroad", "--no-surfaces"), "new.laz has no results of label: label it first"),
        (("new.laz", "later_mlsroad"), "new.laz has no results of label: label it first"),
        (("first", "later_mlsroad", "-o", "later"), "is a folder of the survey itself: name another folder"),
        (("first", "later_mlsroad", "-o", "first_mlsroad"), "is a folder of the survey itself: name another folder"),
    ],
)
def test_errors_are_one_line(run, folder, arguments, message):
    (folder / "empty").mkdir(exist_ok=True)
    (folder / "register.csv").write_text("kind,x,y\npole,1,2\n")
    shutil.copy(folder / "first/survey.laz", folder / "new.laz")
    done = run("compare", *arguments, cwd=folder)
    assert done.returncode == 1 and message in done.stderr and done.stderr.count("\n") == 1


def test_a_table_that_is_no_comparison_gives_no_keys(run, folder, compared):
    copied = shutil.copytree(folder / "first_mlsroad", folder / "other")
    (copied / "changes").mkdir()
    (copied / "changes/changes.csv").write_text("a,b\n1,2\n")
    done = run("compare", "other", "later_mlsroad", "--no-surfaces", "-o", "x", cwd=folder)
    assert done.returncode == 1 and "other/changes/changes.csv: no columns key and second_id" in done.stderr

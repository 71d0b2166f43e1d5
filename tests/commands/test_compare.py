"""The command `mlsroad compare` on a street listed from its true classes: planted errors of a register are found."""

import shutil

import geopandas as gpd
import numpy as np
import pandas as pd
import pytest
from helpers.forking import ALONE
from helpers.labelled import write_true_classes

from mlsroad_pipeline.review.corrections import Correction, open_corrections

SHIFT = np.array([1.2, -0.7])
GIVEN = ("--class-map", "mlsroad", *ALONE)
"""Options of `inventory`: the classes of the points are those of the file."""


@pytest.fixture(scope="module")
def folder(run, tmp_path_factory):
    """A street, and its own inventory as a register with another origin and planted errors."""
    place = tmp_path_factory.mktemp("compared")
    street = ("simulate", "--preset", "small", "--seed", "31", "--length", "60", "--params", "with_images=false")
    done = run(*street, cwd=place)
    assert done.returncode == 0, done.stderr
    write_true_classes(place / "street/survey.laz")
    done = run("inventory", "street", *GIVEN, cwd=place)
    assert done.returncode == 0, done.stderr
    objects = gpd.read_parquet(place / "street_mlsroad/inventory.parquet")
    upright = objects[objects["kind"] != "vehicle"].reset_index(drop=True)
    assert len(upright) > 15
    register = pd.DataFrame(upright[["object_id", "kind", "x", "y", "height"]]).iloc[1:]  # the first is new
    path = pd.read_csv(place / "street/trajectory.csv").iloc[lambda t: [len(t) // 2]][["x", "y"]].to_numpy()[0]
    planted = [(901, "pole", *path, 4.0), (902, "tree", *(path + [0, 5000]), 6.0)]  # on the road, and far away
    register = pd.concat([register, pd.DataFrame(planted, columns=register.columns)])
    register["x"], register["y"] = register["x"] - SHIFT[0], register["y"] - SHIFT[1]
    register = register.rename(columns={"object_id": "nr", "kind": "sort"})
    register.to_csv(place / "register.csv", index=False)
    return place


OPTIONS = ("--column", "id=nr", "--column", "kind=sort")


@pytest.fixture(scope="module")
def compared(run, folder):
    return run("compare", "register.csv", "street_mlsroad", *OPTIONS, cwd=folder)


def test_states_are_written_and_printed(folder, compared):
    assert compared.returncode == 0, compared.stderr
    assert "The register was moved by +1.20 m in x and -0.70 m in y" in compared.stdout
    table = pd.read_csv(folder / "street_mlsroad/register/register.csv")
    entries = table[table["state"] != "new"].set_index("id")
    assert entries.loc[901, "state"] == "not found" and entries.loc[901, "rays"] > 100
    assert entries.loc[902, "state"] == "not visible" and entries.loc[902, "rays"] == 0
    others = entries.drop([901, 902])
    assert (others["state"] == "confirmed").all() and others["distance"].max() < 0.02
    assert (others["object_id"] == others.index).all()
    assert len(table[table["state"] == "new"]) == 1
    layer = gpd.read_file(folder / "street_mlsroad/register/register.gpkg", layer="register")
    assert layer["state"].tolist() == table["state"].tolist() and layer.crs is not None


def test_states_are_not_replaced_unasked(run, folder, compared):
    assert compared.returncode == 0
    again = run("compare", "register.csv", "street_mlsroad", *OPTIONS, cwd=folder)
    assert again.returncode == 1 and "holds the states of a register" in again.stderr
    other = run("compare", "register.csv", "street", *OPTIONS, "-o", "other", cwd=folder)
    assert other.returncode == 0, other.stderr  # the survey names its results
    first, second = (folder / place / "register.gpkg" for place in ("street_mlsroad/register", "other"))
    assert first.read_bytes() == second.read_bytes()


def test_a_checked_state_stays_over_a_new_comparison(run, folder, compared):
    assert compared.returncode == 0
    path = folder / "street_mlsroad/register/register.csv"
    entry = pd.read_csv(path).set_index("id").loc[901]
    payload = {"table": "register", "entry": "901", "state": "not found", "checked": "right"}
    payload |= {"x": float(entry["x"]), "y": float(entry["y"])}
    with open_corrections(folder / "street_mlsroad") as store:
        store.add(Correction("check", kind="pole", payload=payload), who="ann")
    done = run("compare", "register.csv", "street_mlsroad", *OPTIONS, "--overwrite", cwd=folder)
    assert done.returncode == 0, done.stderr
    table = pd.read_csv(path).set_index("id")
    assert table.loc[901, "checked"] == "right" and table["checked"].notna().sum() == 1
    layer = gpd.read_file(path.with_suffix(".gpkg"), layer="register")
    assert layer["checked"].tolist().count("right") == 1


def test_without_the_file_of_the_trajectory_the_path_of_the_inventory_serves(run, folder, compared):
    assert compared.returncode == 0
    shutil.move(folder / "street/trajectory.csv", folder / "moved.csv")
    done = run("compare", "register.csv", "street_mlsroad", *OPTIONS, "-o", "without", cwd=folder)
    shutil.move(folder / "moved.csv", folder / "street/trajectory.csv")
    assert done.returncode == 0 and "trajectory.csv is missing: rays begin at" in " ".join(done.stdout.split())
    table = pd.read_csv(folder / "without/register.csv").set_index("id")
    assert table.loc[901, "state"] == "not found"


def test_without_any_trajectory_nothing_is_not_found(run, folder, compared):
    assert compared.returncode == 0
    (folder / "still").mkdir()
    shutil.copy(folder / "street/survey.laz", folder / "still")
    done = run("inventory", "still", *GIVEN, "--params", "ingest.estimate_trajectory=false", cwd=folder)
    assert done.returncode == 0, done.stderr
    done = run("compare", "register.csv", "still_mlsroad", *OPTIONS, cwd=folder)
    assert done.returncode == 0 and "has no trajectory, from which rays begin" in " ".join(done.stdout.split())
    states = pd.read_csv(folder / "still_mlsroad/register/register.csv")["state"]
    assert (states == "confirmed").sum() > 10 and "not found" not in set(states) and "not visible" in set(states)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("none.csv", "street_mlsroad"), "none.csv does not exist"),
        (("register.csv", "."), "holds no finished results of label"),
        (("register.csv", "street_mlsroad", "-o", "x"), "no column 'kind'"),
    ],
)
def test_errors_are_one_line(run, folder, arguments, message):
    done = run("compare", *arguments, cwd=folder)
    assert done.returncode == 1 and message in done.stderr and done.stderr.count("\n") == 1


def test_the_register_is_never_replaced_by_its_states(run, folder, compared):
    assert compared.returncode == 0
    own = folder / "own"
    own.mkdir()
    shutil.copy(folder / "register.csv", own / "register.csv")
    before = (own / "register.csv").read_bytes()
    for more in ((), ("--overwrite",)):
        done = run("compare", "own/register.csv", "street_mlsroad", *OPTIONS, "-o", "own", *more, cwd=folder)
        assert done.returncode == 1 and "own/register.csv is the register to compare" in done.stderr
    assert (own / "register.csv").read_bytes() == before and [path.name for path in own.iterdir()] == ["register.csv"]


def test_other_files_of_the_user_are_not_replaced_either(run, folder, compared):
    assert compared.returncode == 0
    own = folder / "kept"
    own.mkdir()
    (own / "register.csv").write_text("nr,sort\n1,pole\n")
    done = run("compare", "register.csv", "street_mlsroad", *OPTIONS, "-o", "kept", "--overwrite", cwd=folder)
    assert done.returncode == 1 and "kept/register.csv does not hold states of a register" in done.stderr
    assert (own / "register.csv").read_text() == "nr,sort\n1,pole\n"


def test_rejected_objects_confirm_no_entry(run, folder, compared):
    copied = shutil.copytree(folder / "street_mlsroad", folder / "rejected")
    table = pd.read_csv(folder / "street_mlsroad/register/register.csv")
    number = int(table.loc[(table["state"] == "confirmed") & (table["kind"] == "tree"), "object_id"].iloc[0])
    with open_corrections(copied) as store:
        store.add(Correction("reject", number), who="ann")
    done = run("compare", "register.csv", "rejected", *OPTIONS, "-o", "after", cwd=folder)
    assert done.returncode == 0, done.stderr
    entries = pd.read_csv(folder / "after/register.csv").set_index("id")
    assert entries.loc[number, "state"] != "confirmed" and (entries["state"] == "confirmed").sum() > 5


def test_a_register_of_another_place_is_warned_of(run, folder):
    far = pd.read_csv(folder / "register.csv").iloc[:-1]
    far.assign(x=far["x"] + 50_000).to_csv(folder / "far.csv", index=False)
    done = run("compare", "far.csv", "street_mlsroad", *OPTIONS, "-o", "far", cwd=folder)
    assert done.returncode == 0 and "The entries of the register are 49," in " ".join(
        (done.stdout + done.stderr).split()
    )

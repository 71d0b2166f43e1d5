"""The command `mlsroad` as a user types it: in an empty folder, without a project."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import geopandas
import laspy
import numpy as np
import pandas
import pytest
from helpers.forking import ALONE

COMMAND = Path(sys.executable).with_name("mlsroad")


@pytest.fixture(scope="module")
def folder(run, tmp_path_factory):
    """Folder with a simulated street, and a copy in a file whose name has a comma and a blank."""
    place = tmp_path_factory.mktemp("user")
    done = run(
        "simulate", "--preset", "tiny", "--seed", "3", "--length", "20", "--params", "with_images=false", cwd=place
    )
    assert done.returncode == 0, done.stderr
    shutil.copy(place / "street/survey.laz", place / "one, two.laz")
    return place


def variables():
    return {k: v for k, v in os.environ.items() if not k.startswith(("MLFLOW_", "KEDRO_", "COV_"))}


def mlsroad(*arguments, cwd, **environment):
    """Run the command and return what it said; stderr is no terminal, so no bar is drawn."""
    return subprocess.run(
        [COMMAND, *map(str, arguments)],
        cwd=cwd, env=variables() | environment, capture_output=True, text=True, timeout=300, check=False,
    )  # fmt: skip


@pytest.fixture(scope="module")
def labelled(folder):
    """Result of `mlsroad label FILE`: exit code and output."""
    return mlsroad("label", "one, two.laz", cwd=folder)


def test_a_file_is_labelled_beside_itself(folder, labelled):
    assert (labelled.returncode, labelled.stderr) == (0, "")
    results = folder / "one, two_mlsroad"
    before, after = laspy.read(folder / "one, two.laz"), laspy.read(results / "one, two.laz")
    assert np.array_equal(before.xyz, after.xyz)
    assert np.unique(after.classification).size > 2
    assert len(geopandas.read_parquet(results / "inventory.parquet")) == len(
        geopandas.read_file(results / "inventory.gpkg", layer="objects")
    )


def test_it_ends_with_counts_warnings_and_paths(folder, labelled):
    lines = labelled.stdout.splitlines()
    n_points = len(laspy.read(folder / "one, two.laz"))
    assert lines[0].startswith(f"Labelled {n_points:,} points of 1 file in ")
    counts = re.findall(r"^\S.*?\s{2,}([\d,]+)\s+[\d.]+ %", labelled.stdout, re.MULTILINE)
    assert sum(int(count.replace(",", "")) for count in counts) == n_points
    for line in ("  points     one, two_mlsroad/one, two.laz", "  inventory  one, two_mlsroad/inventory.gpkg"):
        assert line in lines
    assert lines[-1] == "Open it in the browser: mlsroad open 'one, two_mlsroad'"


def test_nothing_is_written_outside_the_results(folder, labelled):
    assert labelled.returncode == 0
    assert sorted(path.name for path in folder.iterdir()) == ["one, two.laz", "one, two_mlsroad", "street"]


def test_the_same_command_again_says_that_it_is_done(run, folder, labelled):
    before = {path: path.stat().st_mtime_ns for path in (folder / "one, two_mlsroad").iterdir() if path.is_file()}
    again = run("label", "one, two.laz", *ALONE, cwd=folder)
    assert (again.returncode, again.stderr) == (0, "")
    assert again.stdout.startswith("Already labelled: ")
    assert again.stdout.splitlines()[1:] == labelled.stdout.splitlines()[1:]
    assert {path: path.stat().st_mtime_ns for path in before} == before


def test_an_edited_inventory_is_kept(run, folder, labelled):
    inventory = folder / "one, two_mlsroad/inventory.gpkg"
    kept = inventory.read_bytes()
    inventory.write_bytes(kept + b"edited")
    refused = run("label", "one, two.laz", *ALONE, cwd=folder)
    assert refused.returncode == 1
    assert refused.stdout == ""
    assert re.fullmatch(r"Error: .*inventory\.gpkg.*--overwrite.*\n", refused.stderr)
    assert inventory.read_bytes() == kept + b"edited"
    inventory.write_bytes(kept)


def test_the_inventory_is_scored_against_the_objects_of_the_street(run, folder, labelled, tmp_path):
    assert labelled.returncode == 0
    command = ("score", "one, two_mlsroad", "--truth", "street", "-o", tmp_path / "scores")
    done = run(*command, cwd=folder)
    assert (done.returncode, done.stderr) == (0, "")
    record = json.loads((tmp_path / "scores/object_scores.json").read_text(encoding="utf-8"))
    scores = {row["kind"]: row for row in record["scores"]}
    outcomes = pandas.read_csv(tmp_path / "scores/object_outcomes.csv")
    true = pandas.read_csv(tmp_path / "scores/true_object_outcomes.csv")
    inventory = geopandas.read_parquet(folder / "one, two_mlsroad/inventory.parquet")
    assert sorted(outcomes["object_id"]) == sorted(inventory["object_id"])
    for kind, row in scores.items():
        of_kind = outcomes if kind == "all" else outcomes[outcomes["kind"] == kind]
        assert [row["right"], row["false"]] == [int((of_kind["outcome"] == name).sum()) for name in ("right", "false")]
        assert re.search(rf"^{kind}\s+{row['true']}\s+{row['found']}\s+{row['listed']}\s", done.stdout, re.MULTILINE)
    assert scores["all"]["found"] == (true["outcome"] == "found").sum() > 0
    assert (true.loc[true["counted"], "points"] >= 10).all() and not true["counted"].all()
    page = (tmp_path / "scores/object_scores.html").read_text(encoding="utf-8")
    assert page.count("<img") > 3
    again = run(*command, cwd=folder)
    assert (again.returncode, again.stdout) == (1, "")
    assert re.fullmatch(r"Error: .*scores holds scores: .*--overwrite\n", again.stderr)


def test_a_table_that_is_no_truth_is_one_line(run, folder, labelled, tmp_path):
    assert labelled.returncode == 0
    (tmp_path / "mine.csv").write_text("kind,east,north\npole,1,2\n", encoding="utf-8")
    done = run("score", "one, two_mlsroad", "--truth", tmp_path / "mine.csv", "-o", tmp_path / "s", cwd=folder)
    assert (done.returncode, done.stdout) == (1, "")
    assert re.fullmatch(r"Error: .*mine\.csv: .*needs the column x \(has kind, east, north\)\n", done.stderr)
    assert not (tmp_path / "s").exists()


@pytest.mark.parametrize("sent", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupt_of_all_processes_is_one_line(folder, tmp_path, sent):
    code = "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler); sys.argv[0] = 'mlsroad'"
    command = [sys.executable, "-c", f"{code}; from mlsroad_pipeline.commands.app import main; main()"]
    arguments = ["label", str(folder / "one, two.laz"), "-o", str(tmp_path / "out")]
    with subprocess.Popen(
        [*command, *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    ) as process:
        deadline = time.monotonic() + 60
        while not (tmp_path / "out").exists() and time.monotonic() < deadline:
            time.sleep(0.01)
        os.killpg(process.pid, sent)
        assert process.communicate(timeout=60)[1] == "Interrupted. The same command continues from here.\n"
    assert process.returncode == 130


def test_several_files_form_one_survey(run, folder):
    done = run("label", "one, two.laz", "street", "-o", "both", *ALONE, "--params", "label.scheme=asprs", cwd=folder)
    assert done.returncode == 0, done.stderr
    assert "points of 2 files" in done.stdout.splitlines()[0]
    assert sorted(str(path.relative_to(folder / "both")) for path in (folder / "both").rglob("*.laz")) == [
        "one, two.laz",
        "street/survey.laz",
    ]
    shutil.rmtree(folder / "both")


def test_an_environment_variable_turns_tracking_on(folder, tmp_path):
    uri = f"sqlite:///{tmp_path}/runs.db"
    command = ("label", folder / "one, two.laz", "-o", tmp_path / "out", *ALONE)
    done = mlsroad(*command, cwd=tmp_path, MLFLOW_TRACKING_URI=uri)
    assert (done.returncode, done.stderr) == (0, "")
    assert (tmp_path / "runs.db").is_file()


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["label", "no.laz"], 1, r"Error: .*no\.laz does not exist"),
        (["label", "empty.las"], 1, r"Error: .*empty\.las.*"),
        (["label", "street", "--method", "forest"], 1, r"Error: .*forest.*detrended_forest.*"),
        (["label", "street", "--crs", "EPSG:0"], 1, r"Error: .*EPSG:0.*"),
        (["label", "street", "--params", "label.skeme=x"], 1, r"Error: .*skeme.*scheme.*"),
        (["label", "street", "-o", "street"], 1, r"Error: .*street.*"),
        (["simulate", "-o", "street"], 1, r"Error: .*street is not empty.*--overwrite.*"),
        (["simulate", "-o", "new", "--preset", "vmx"], 1, r"Error: .*vmx.*vmx450.*"),
        (["open", "nowhere"], 1, r"Error: .*nowhere holds no report.*"),
    ],
)
def test_an_error_is_one_line_with_cause_and_value(run, folder, tmp_path, arguments, code, message):
    (tmp_path / "empty.las").touch()
    os.symlink(folder / "street", tmp_path / "street")
    done = run(*arguments, *(ALONE if arguments[0] == "label" else ()), cwd=tmp_path)
    assert (done.returncode, done.stdout) == (code, "")
    assert re.fullmatch(message + r"\n", done.stderr), done.stderr
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize("arguments", [["label"], ["label", "a.laz", "--workers", "0"], ["lable", "a.laz"]])
def test_a_wrong_command_line_has_the_exit_code_2(folder, arguments):
    assert mlsroad(*arguments, cwd=folder).returncode == 2


def test_verbose_shows_the_traceback(run, folder):
    done = run("label", "no.laz", "--verbose", *ALONE, cwd=folder)
    assert done.returncode == 1
    assert "Traceback (most recent call last)" in done.stderr
    assert done.stderr.strip().splitlines()[-1].startswith("Error: ")


def test_inspect_of_files_that_cannot_be_read_is_an_error(run, tmp_path):
    for name in ("a.laz", "b.laz"):
        (tmp_path / name).write_bytes(b"")
    done = run("inspect", tmp_path / "a.laz", tmp_path / "b.laz", "-o", tmp_path / "quality", cwd=tmp_path)
    assert done.returncode == 1
    assert done.stderr.strip() == f"Error: {tmp_path / 'a.laz'} is empty (0 bytes) (and 1 more)"


def test_inspect_says_where_its_report_is(run, folder, tmp_path):
    done = run("inspect", folder / "street", "-o", tmp_path / "quality", cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.splitlines()[-1] == "Report: quality/inspection.html"
    facts = json.loads((tmp_path / "quality/inspection.json").read_text(encoding="utf-8"))
    assert f"{facts['n_points']:,} points in 1 file." in done.stdout


def test_open_finds_the_report_by_the_survey(run, folder, labelled):
    assert labelled.returncode == 0
    for name in ("one, two.laz", "one, two_mlsroad"):
        done = run("open", name, "--report", "--no-browser", cwd=folder)
        assert (done.returncode, done.stdout.strip()) == (0, str(folder / "one, two_mlsroad/report.html"))


def test_help_imports_no_numerical_library(folder):
    code = "import sys; from mlsroad_pipeline.commands.app import app; print([n for n in ('numpy', 'kedro', 'mlflow', 'torch') if n in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=folder)
    assert done.stdout.strip() == "[]"


def test_models_names_the_one_that_label_takes(run, folder):
    done = run("models", cwd=folder)
    assert (done.returncode, done.stderr) == (0, "")
    assert "general: boosted_trees, shipped" in done.stdout
    assert "label takes the shipped model pool: it is the default model of the package." in " ".join(
        done.stdout.split()
    )
    refused = run("models", "one, two.laz", cwd=folder)
    assert refused.returncode == 2 and "unexpected extra argument" in refused.stderr


def test_a_closed_standard_output_is_no_error(folder):
    done = subprocess.run(
        f"'{COMMAND}' models >&-", shell=True, cwd=folder, stderr=subprocess.PIPE, text=True, timeout=60, check=False
    )
    assert (done.returncode, done.stderr) == (0, "")


def test_learn_continues_the_model_and_keeps_the_corrections(run, labelled, folder, tmp_path):
    """Accept, reject and paint, learn, label again: the decisions stand in the new inventory."""
    from mlsroad_pipeline.model_store.object_classifiers import shipped_classifier
    from mlsroad_pipeline.review.corrections import Correction, open_corrections

    assert labelled.returncode == 0
    out = tmp_path / "out"
    shutil.copytree(folder / "one, two_mlsroad", out)
    with open_corrections(out) as store:
        table = store.objects().table
        sure = table.sort_values("score")["object_id"].to_numpy()
        store.add(Correction("accept", int(sure[-1])), who="ann")
        payload = {"file": "one, two.laz", "points": list(range(300)), "class": "building"}
        store.add(Correction("paint", payload=payload), who="ann")
    done = run("learn", out, cwd=folder)
    assert done.returncode == 0, done.stderr
    said = " ".join(done.stdout.split())
    assert "Learned from 2 answers" in said and "pool-" in said
    assert "the whole of each survey is labelled again" in " ".join(done.stderr.split())
    (model,) = (out / "models").iterdir()
    metadata = json.loads((model / "model.json").read_text())["metadata"]
    assert metadata["learned"][0]["parent"]["name"] == "pool"
    with np.load(model / "arrays.npz") as arrays:  # the object classifier has learned from the accepted object
        kind = str(table.loc[table["object_id"] == sure[-1], "kind"].item())
        n_trees = len(arrays[f"object_judge/{kind}/n_leaves"])
    assert n_trees > len(shipped_classifier().trees[kind])
    objects = geopandas.read_file(out / "inventory.gpkg", layer="objects")
    assert set(objects["model_version"]) == {model.name}
    assert (objects["status"] == "accepted").sum() == 1
    with open_corrections(out) as store:
        assert len(store.current()) == 2
    assert "Comparison: no difference, because fewer than 8 answers are too few to hold some out" in said
    assert "Changed by the learning" in said and f"mlsroad learn --undo {out}" in said
    undone = run("learn", "--undo", out, cwd=folder)
    assert (undone.returncode, undone.stderr) == (0, "")
    before = folder / "one, two_mlsroad"
    for name in ("one, two.laz", "inventory.gpkg", "report.html"):
        assert (out / name).read_bytes() == (before / name).read_bytes()
    with open_corrections(out) as store:
        assert len(store.current()) == 2
    (out / "corrections.sqlite").write_bytes(b"x" * 5000)
    refused = run("label", folder / "one, two.laz", "-o", out, "--overwrite", *ALONE, cwd=folder)
    assert refused.returncode == 1 and "corrections.sqlite is damaged" in " ".join(refused.stderr.split())


def test_a_model_of_another_method_learns_with_trees_that_correct_it(labelled, folder, tmp_path):
    from mlsroad_pipeline.algorithms.models.labelling import label_softly
    from mlsroad_pipeline.algorithms.models.pool.labeller import NETWORK, members_of
    from mlsroad_pipeline.formats.registry import get_format
    from mlsroad_pipeline.model_store.shipped_models import load_shipped
    from mlsroad_pipeline.review.corrections import Correction, open_corrections
    from mlsroad_pipeline.review.corrections.labelled_output import LabelledOutput
    from mlsroad_pipeline.review.corrections.learning import read_corrections, train_on

    assert labelled.returncode == 0
    shutil.copytree(folder / "one, two_mlsroad", tmp_path / "out")
    output, parent = LabelledOutput.at(tmp_path / "out"), {"name": "network", "version": ""}
    survey = tmp_path / "out" / "one, two.laz"
    cloud = get_format(survey).read(survey, output.read_options())
    network = members_of(load_shipped("pool"))[NETWORK]
    before = label_softly(network, cloud).labels
    painted = np.flatnonzero(before == network.classes.index("paved ground"))[:2000]
    with open_corrections(tmp_path / "out") as store:
        for part in np.split(painted, 10):
            payload = {"file": "one, two.laz", "points": part.tolist(), "class": "natural ground"}
            store.add(Correction("paint", payload=payload), who="ann")
    model, n_answers = train_on(network, read_corrections(network, [output]), parent=parent, surveys=["out"])
    more = read_corrections(model, [output])
    again, _ = train_on(model, more, parent={"name": "corrected", "version": "1"}, surveys=["out"])
    assert (model.slug, n_answers, model.metadata["trained_on"]["corrections"]) == ("corrected", 10, 10)
    assert [entry["parent"]["name"] for entry in again.metadata["learned"]] == ["network", "corrected"]
    assert again.metadata["trained_on"]["corrections"] == 20
    after = label_softly(model, cloud).labels
    assert (after[painted] == network.classes.index("natural ground")).mean() > 0.5
    assert (before[painted] == after[painted]).mean() < 0.5 < (before == after).mean()


def test_added_objects_alone_train_the_object_classifier(labelled, folder, tmp_path):
    from mlsroad_pipeline.model_store.object_classifiers import classifier_of, shipped_classifier
    from mlsroad_pipeline.model_store.shipped_models import load_shipped
    from mlsroad_pipeline.review.corrections import Correction, open_corrections
    from mlsroad_pipeline.review.corrections.labelled_output import LabelledOutput
    from mlsroad_pipeline.review.corrections.learning import read_corrections, train_on

    assert labelled.returncode == 0
    shutil.copytree(folder / "one, two_mlsroad", tmp_path / "out")
    with open_corrections(tmp_path / "out") as store:
        best = store.objects().table.sort_values("score").iloc[-1]  # where a candidate stands
        place = {axis: float(best[axis]) for axis in "xyz"}
        store.add(Correction("add", kind=str(best["kind"]), payload=place), who="ann")
        store.add(Correction("add", kind="pole", payload={**place, "x": place["x"] + 500.0}), who="ann")
    general = load_shipped("general")
    parent = {"name": "general", "version": ""}
    data = read_corrections(general, [LabelledOutput.at(tmp_path / "out")])
    model, n_answers = train_on(general, data, parent=parent, surveys=["out"])
    assert n_answers == 1 and model.metadata["learned"][-1]["added_objects"] == 1
    assert len(model.arrays["leaf"]) == len(general.arrays["leaf"])  # no points, so the labels stay
    kind = str(best["kind"])
    assert len(classifier_of(model).trees[kind]) > len(shipped_classifier().trees[kind])

"""Results that `learn` may replace, and the settings with which it labels again."""

import json

import laspy
import pytest
from pyproj import CRS
from typer.testing import CliRunner

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.commands.app import app
from mlsroad_pipeline.execution.run_folder import entries_of
from mlsroad_pipeline.formats.registry import get_format
from mlsroad_pipeline.review.corrections.labelled_output import LabelledOutput


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "street.laz").write_bytes(b"points")
    (tmp_path / "street_classes.ply").write_bytes(b"colours")
    write_record(tmp_path, "one", "finished")
    return tmp_path


def write_record(folder, run, state, **label):
    outputs = [
        {**entry, "path": entry["path"].rpartition("/")[2]} for entry in entries_of(map(str, folder.glob("street*")))
    ]
    record = {
        "format": 1,
        "state": state,
        "settings": {"label": {"survey": ["street.laz"], "model": None, "method": None, **label}},
        "inputs": [{"path": "/data/street.laz"}],
        "summary": {"model": {"name": "general", "version": "1"}, "method": "boosted_trees"},
        "outputs": outputs,
    }
    (folder / ".mlsroad" / run).mkdir(parents=True, exist_ok=True)
    (folder / ".mlsroad" / run / "run.json").write_text(json.dumps(record))


def test_learn_keeps_edited_results(folder):
    LabelledOutput.at(folder).check_unedited()
    (folder / "street.laz").write_bytes(b"edited")
    result = CliRunner().invoke(app, ["learn", str(folder), "--no-label"])
    said = " ".join(result.output.split())
    assert (result.exit_code, "street.laz was edited since it was written: copy it" in said) == (1, True), said
    assert (folder / "street.laz").read_bytes() == b"edited"


def test_results_of_a_killed_run_beside_an_older_record_are_refused(folder):
    (folder / "street.laz").write_bytes(b"points of another model")
    write_record(folder, "two", "unfinished")
    with pytest.raises(DataError, match=r"street\.laz is of a run of label that was not finished"):
        LabelledOutput.at(folder).check_unedited()


def test_the_survey_is_labelled_again_with_the_same_settings(folder):
    write_record(folder, "one", "finished", kerbs=None, trajectory=None, images=None, least_score=0.2)
    again = LabelledOutput.at(folder).parameters()
    assert again == {
        **dict.fromkeys(("kerbs", "trajectory", "images")),
        **{"survey": ["street.laz"], "least_score": 0.2},
        **{"coloured_ply": True, "output": str(folder), "overwrite": True},
    }


def test_the_labelled_files_are_read_in_the_unit_of_their_system(folder):
    assert LabelledOutput.at(folder).read_options().units == "crs"
    write_record(folder, "one", "finished", read={"units": 0.3048, "only": ["intensity"]}, crs="EPSG:2225")
    options = LabelledOutput.at(folder).read_options()
    assert (options.units, options.only, CRS(options.crs)) == (0.3048, None, CRS("EPSG:2225"))


def test_a_labelled_file_in_feet_is_read_in_metres(folder):
    las = laspy.LasData(laspy.LasHeader(point_format=6, version="1.4"))
    las.x, las.y, las.z = [[100.0, 200.0]] * 3
    las.header.add_crs(CRS("EPSG:2225"))  # US survey feet
    las.write(folder / "street.laz")
    path = folder / "street.laz"
    xyz = get_format(path).read(path, LabelledOutput.at(folder).read_options()).xyz
    assert xyz[1, 0] - xyz[0, 0] == pytest.approx(30.48, abs=0.01)

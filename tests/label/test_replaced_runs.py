"""Descriptions of replaced results are removed with them; clouds, edited files and files of others stay."""

import pytest

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.execution.run_folder import RunFolder, entries_of
from mlsroad_pipeline.label.checks import check_headers
from mlsroad_pipeline.label.runs import is_companion
from mlsroad_pipeline.surveys.parameters import LabelParameters
from mlsroad_pipeline.surveys.plan import IngestParameters, plan_labelling


def finished_run(output, name, files):
    """Write files as a finished run."""
    for file in files:
        (output / file).parent.mkdir(parents=True, exist_ok=True)
        (output / file).write_text(f"{name} {file}")
    run = RunFolder(str(output / ".mlsroad" / name))
    entries = [{**e, "path": e["path"].removeprefix(f"{output}/")} for e in entries_of(str(output / f) for f in files)]
    run.write({"outputs": entries, "inputs": [], "state": "finished"})
    return run


def test_stale_files_of_the_replaced_run_are_removed(tmp_path):
    others = ["photos/1.jpg", "photos/photos.csv", "sections.csv", "inventory.csv", "a.prj", "other.prj", "b.prj"]
    finished_run(tmp_path, "first", ["a.laz", "other.laz", "inventory.gpkg", "report.html", *others])
    (tmp_path / "b.prj").write_text("edited")
    (tmp_path / "photos/mine.jpg").write_text("of the user")
    new = RunFolder(str(tmp_path / ".mlsroad/second"))
    new.write({"inputs": [], "outputs": [], "overwrite": True})
    for file in ("a.laz", "b.laz", "inventory.gpkg", "report.html"):
        staged = new.staged(tmp_path / file)
        staged.parent.mkdir(parents=True, exist_ok=True)
        staged.write_text("new")
        new.publish(staged)
    expected = ["a.prj", "inventory.csv", "photos/1.jpg", "photos/photos.csv", "sections.csv"]
    assert new.remove_stale(is_companion) == expected
    left = {
        p.relative_to(tmp_path).as_posix() for p in tmp_path.rglob("*") if p.is_file() and ".mlsroad" not in p.parts
    }
    clouds = {"a.laz", "b.laz", "other.laz", "inventory.gpkg", "report.html"}
    assert left == {*clouds, "other.prj", "b.prj", "photos/mine.jpg"}


def test_sections_of_several_drives_are_refused_before_any_work(tmp_path):
    for name in ("north", "south"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "a.xyz").write_text("0 0 0\n1 1 1\n2 2 2\n")
    given = LabelParameters(str(tmp_path), str(tmp_path / "out"), sections="s.csv")
    plan = plan_labelling(given, IngestParameters())
    with pytest.raises(ParameterError, match=r"stations of one path, but the survey has 2 passes \(.*north, .*south\)"):
        check_headers(plan, given)

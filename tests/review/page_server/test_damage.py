"""Outputs that are damaged, empty or hold links, and what the page says of them."""

import sqlite3
from contextlib import nullcontext

import numpy as np
import pytest
from helpers.page_output import FILES, write_laz, write_output

from mlsroad_pipeline.algorithms.core.exceptions import ReadError
from mlsroad_pipeline.review.page_server.export import ExportError, _photos, export_page
from mlsroad_pipeline.review.page_server.output_folder import OutputFolder
from mlsroad_pipeline.review.page_server.served_survey import ServedSurvey
from mlsroad_pipeline.review.page_server.tile_cache import page_lock


def test_damaged_inventories_are_named(tmp_path):
    path = tmp_path / "inventory.gpkg"
    output = OutputFolder(tmp_path, {})
    for content in (b"garbage" * 1000, b""):
        path.write_bytes(content)
        with pytest.raises(ReadError, match=r"inventory\.gpkg is damaged") if content else nullcontext():
            output.objects()
    with sqlite3.connect(path) as base:
        base.execute("CREATE TABLE trajectory (geom BLOB)")
        base.execute("INSERT INTO trajectory VALUES (x'4750')")
    base.close()
    with pytest.raises(ReadError, match=r"inventory\.gpkg is damaged"):
        output.path_vertices()


def test_a_damaged_record_is_named(tmp_path):
    write_output(tmp_path)
    [record] = tmp_path.glob(".mlsroad/*/run.json")
    for text in ("{", "[]", '{"state": "finished"}'):
        record.write_text(text, encoding="utf-8")
        with pytest.raises(ReadError, match=r"run\.json is damaged: label the survey again"):
            OutputFolder.find(tmp_path)


def test_an_output_without_points_is_told_in_one_line(tmp_path):
    write_output(tmp_path)
    for name in FILES:
        write_laz(tmp_path / name, np.zeros((0, 3)), np.zeros(0), np.zeros(0))
    with pytest.raises(ReadError, match="the labelled files hold no points, there is nothing to show"):
        ServedSurvey(OutputFolder.find(tmp_path), user="ann")


def test_an_exported_page_holds_nothing_from_elsewhere_and_leaves_the_folder_as_it_is(tmp_path):
    output, elsewhere = tmp_path / "out", tmp_path / "secret.jpg"
    write_output(output)
    elsewhere.write_bytes(b"secret of another folder")
    (output / "photos/2.jpg").symlink_to(elsewhere)
    before = sorted(output.rglob("*"))
    page = export_page(OutputFolder.find(output), tmp_path / "page.html", most=1000)
    assert sorted(output.rglob("*")) == before
    photos = _photos(output)
    assert list(photos) == ["1"] and page.is_file()
    (output / FILES[0]).rename(tmp_path / "one.laz")
    (output / FILES[0]).symlink_to(tmp_path / "one.laz")
    with pytest.raises(ExportError, match="is not in the folder"):
        export_page(OutputFolder.find(output), tmp_path / "other.html", most=1000)
    assert not (tmp_path / "other.html").exists()


@pytest.mark.parametrize("target", ["lock", "folder"])
def test_a_link_in_place_of_the_lock_is_refused_and_its_file_stays(tmp_path, target):
    precious = tmp_path / "precious"
    precious.mkdir()
    (precious / "lock").write_text("mine", encoding="utf-8")
    if target == "folder":
        (tmp_path / ".page").symlink_to(precious)
    else:
        (tmp_path / ".page").mkdir()
        (tmp_path / ".page/lock").symlink_to(precious / "lock")
    with pytest.raises(ReadError, match="remove"), page_lock(tmp_path):
        pass
    assert (precious / "lock").read_text(encoding="utf-8") == "mine"

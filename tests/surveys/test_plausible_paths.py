"""Plausible faults of the files and folders of surveys: copies, links, names and paths."""

import gzip
import os
import shutil

import numpy as np
import pytest
from helpers.formats import make_las
from helpers.plain_clouds import write

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError, ReadError
from mlsroad_pipeline.algorithms.scenes.parameters import IngestParameters
from mlsroad_pipeline.config import ParameterConfigLoader
from mlsroad_pipeline.execution.parameter_checks import check_paths, with_text_of_paths
from mlsroad_pipeline.formats.base import ReadOptions
from mlsroad_pipeline.label.runs import planned_paths
from mlsroad_pipeline.surveys.files import Survey, SurveyFile
from mlsroad_pipeline.surveys.parameters import LabelParameters
from mlsroad_pipeline.surveys.plan import plan_labelling, plan_survey

# folders


def test_copies_links_and_empty_tiles_are_listed_once(tmp_path, rng):
    root = tmp_path / "in"
    las = make_las(root_file(root, "a.laz"), rng, point_format=6, extras=False)
    las.write(str(root / "a.las"))
    shutil.copy(root / "a.laz", root / "a.copc.laz")
    make_las(root_file(root, "b.laz"), rng, point_format=6, extras=False).write(str(root / "b.las"))
    (root / "west").mkdir()
    (root / "west" / "back").symlink_to(root)
    (root / "west" / "loop").symlink_to(root / "west")
    (root / "c.laz").symlink_to(root / "b.laz")
    (root / "there").symlink_to(root / "west")
    (root / "other").mkdir()
    (root / "other" / "west2").symlink_to(root / "other2")
    (root / "other2").mkdir()
    (root / "other2" / "other3").symlink_to(root / "other")
    empty = np.zeros((0, 3))
    for ending in ("ply", "pcd", "npz", "parquet", "e57", "laz"):
        write(root / "tiles" / f"empty_{ending}.{ending}", empty)
    (root / "tiles" / "names.txt").write_text("x y z\n")
    write(root / "tiles" / "full.ply", rng.random((9, 3)))
    listing = Survey.at(root).listing()
    assert [file.name for file in listing.files] == ["a.laz", "b.laz", "tiles/full.ply"]
    reasons = dict(listing.skipped)
    assert reasons["a.copc.laz"] == "is a cloud-optimised copy of a.laz: skipped"
    assert reasons["a.las"] == "is a copy of a.laz: skipped"
    assert reasons["b.las"] == "is a copy of b.laz: skipped"
    for ending in ("ply", "pcd", "e57", "laz"):
        assert "without points: skipped" in reasons[f"tiles/empty_{ending}.{ending}"]
    assert len(Survey.at(str(root / "**" / "*.laz")).listing().files) == 2


def test_links_to_nothing_and_packed_copies_give_a_warning(tmp_path, rng):
    root = tmp_path / "in"
    path = root_file(root, "a.las")
    make_las(path, rng, version="1.2", point_format=1, n=50, extras=False)
    (root / "a.las.gz").write_bytes(gzip.compress(path.read_bytes()))
    (root / "b.laz").symlink_to(root / "gone.laz")
    (root / "c.laz").symlink_to(root / "c.laz")
    for listing in (Survey.at(root).listing(), Survey.at(str(root / "*")).listing()):
        assert [file.name for file in listing.files] == ["a.las"]
        assert listing.skipped == {
            "a.las.gz": "is a copy of a.las: skipped",
            "b.laz": "is a link to a file that does not exist: skipped",
            "c.laz": "is a link to a file that does not exist: skipped",
        }


def root_file(root, name):
    root.mkdir(parents=True, exist_ok=True)
    return root / name


# paths


@pytest.mark.parametrize("text", ["2024_05_01", "0715", "0x1F", "1e3", "20240501", "1:30"])
def test_paths_stay_text(text):
    from mlsroad_pipeline.commands.options import nested

    assert str(nested([f"label.trajectory={text}"])["label"]["trajectory"]) == text
    assert with_text_of_paths({"label": {"output": 3}}, [f"label.output={text}"]) == {"label": {"output": text}}


@pytest.mark.parametrize("text", ["2024_05_01", "0715", "1e3"])
def test_paths_of_kedro_run_stay_text(text):
    import click

    from mlsroad_pipeline.cli import run

    parameter = next(p for p in run.params if p.name == "params")
    given = f"label.survey={text},label.output={text},ingest.scene_length=15"
    read = parameter.process_value(click.Context(run), given)
    assert read == {"label": {"survey": text, "output": text}, "ingest": {"scene_length": 15}}


@pytest.mark.parametrize(
    ("section", "message"),
    [
        ({"label": {"survey": 461}}, r"label\.survey is 461, not text: write a name .* in quotes"),
        ({"label": {"survey": ["a.laz", 7.5]}}, r"label\.survey is 7\.5, not text"),
        ({"label": {"output": True}}, r"label\.output is True, not text"),
        ({"label": {"survey": None}}, r"label\.survey is null: name a file or folder"),
        ({"inspect": {"survey": None}}, r"inspect\.survey is null: name a file or folder, or leave the parameter out"),
        ({"inspect": {"survey": ""}}, r"inspect\.survey is empty"),
        (
            {"label": {"output": "s3://b/out"}},
            r"label\.output is 's3://b/out', an address: this takes a file or folder",
        ),
        ({"label": {"survey": ["a.laz", "https://b/a.laz"]}}, r"label\.survey is 'https://b/a\.laz', an address"),
        ({"label": {"sections": "s3:/b/s.csv"}}, r"label\.sections is 's3:/b/s\.csv', an address"),
        ({"survey": {"root": "gs://b"}}, r"survey\.root is 'gs://b', an address"),
        (
            {"label": {"survey": "na\udcefve.laz"}},
            r"label\.survey is 'na\\udcefve\.laz', a name that is not UTF-8: rename it",
        ),
        ({"score": {"clouds": ["https://h/a.laz"]}}, r"score\.clouds is 'https://h/a\.laz', an address"),
        ({"image_labels": {"masks": "s3://b"}}, r"image_labels\.masks is 's3://b', an address"),
        ({"label": {"model": "s3://b/model"}}, r"label\.model is 's3://b/model', an address"),
        ({"recordings_study": {"a": {"b": ["gs://b"]}}}, r"recordings_study\.a\.b is 'gs://b', an address"),
        ({"label": {"read": {"comment": "\udcef"}}}, r"label\.read\.comment is '\\udcef', a name that is not UTF-8"),
    ],
)
def test_what_is_no_path_is_one_line(section, message):
    with pytest.raises(ParameterError, match=message):
        check_paths(section, section)


def test_texts_that_are_no_files_may_be_addresses():
    label = {"survey": "a.laz", "output": "out"}
    for section in (
        {
            "label": {
                **label,
                "read": {"reproject": "https://www.opengis.net/def/crs/EPSG/0/25832", "comment": "http://"},
            }
        },
        {"label": label, "own": {"reference": "doi:/10"}, "survey": {"source": "https://h/"}},
    ):
        check_paths(section, section)


def test_names_of_files_that_cannot_be_written_are_refused_first_and_long_ones_have_keys(tmp_path, rng):
    folder = tmp_path / "survey"
    folder.mkdir()
    make_las(folder / "street.laz", rng, n=20)
    (folder / os.fsdecode(b"na\xefve.csv")).write_text("x,y,z\n1,2,3\n")
    plan = plan_labelling(LabelParameters(survey=str(folder), output="out"), IngestParameters())
    assert all(name.isprintable() for name in plan.skipped) and len(plan.skipped) == 1
    make_las(folder / os.fsdecode(b"na\xefve.laz"), rng, n=20)

    def planned(*names):
        files = [SurveyFile(str(tmp_path / "x.laz"), name, ".", None) for name in names]
        options = {"options": ReadOptions(), "labels": False, "ingest": IngestParameters(cut="file")}
        return plan_survey({"survey": files}, {}, **options)

    keys = [file.key for file in planned("\u6d4b" * 50 + "a.laz", "\u6d4b" * 50 + "b.laz", "street.laz").files]
    assert len(set(keys)) == 3 and max(map(len, keys)) == 127 and keys[2] == "survey.street_laz"
    with pytest.raises(ReadError, match=r"na\\udcefve\.laz' is a file of the survey with a name that is not UTF-8"):
        plan_labelling(LabelParameters(survey=str(folder), output="out"), IngestParameters())
    output = LabelParameters(survey="x.laz", output="out")
    with pytest.raises(
        ParameterError, match=r"the name of its result has 216 bytes, at most 215 can be written: rename"
    ):
        planned_paths(planned("x" * 212 + ".laz"), tmp_path / "out", output)


def test_the_loader_checks_paths(tmp_path):
    from helpers.wiring import REPOSITORY

    loader = ParameterConfigLoader(
        str(REPOSITORY / "conf"), base_env="base", default_run_env="base", runtime_params={"inspect": {"survey": None}}
    )
    with pytest.raises(ParameterError, match=r"inspect\.survey is null"):
        loader["parameters"]


def test_a_glob_that_leaves_its_folder_is_an_error(tmp_path):
    (tmp_path / "a" / "b").mkdir(parents=True)
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "s.txt").write_text("0 0 0\n1 1 1\n")
    pattern = str(tmp_path / "a" / "*" / ".." / ".." / "other" / "*.txt")
    with pytest.raises(ParameterError, match=r"leaves its folder by '\.\.' after a wildcard: .*s\.txt"):
        Survey.at(pattern).listing()


def test_only_the_table_of_a_simulated_street_is_left_out_without_a_word(tmp_path, rng):
    make_las(root_file(tmp_path / "in", "a.las"), rng, version="1.2", point_format=1, n=50, extras=False)
    table = tmp_path / "in" / "objects.csv"
    for head, skipped in (("instance,label,x,y,z", []), ("x,y,z", ["objects.csv"])):
        table.write_text(f"{head}\n1,2,3,4,5\n")
        listing = Survey.at(tmp_path / "in").listing()
        assert [file.name for file in listing.files] == ["a.las"] and list(listing.skipped) == skipped

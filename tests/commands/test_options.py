"""Options of `mlsroad`: places, default folders, parameters."""

from pathlib import Path

import pytest
import typer
from omegaconf import OmegaConf

from mlsroad_pipeline.commands import session
from mlsroad_pipeline.commands.options import default_output, expanded, nested, results_folder, survey_of
from mlsroad_pipeline.execution.parameter_checks import merged


@pytest.fixture
def street(tmp_path):
    folder = tmp_path / "street"
    (folder / "north").mkdir(parents=True)
    for name in ("a.laz", "b, c.laz", "c.copc.laz", "d.txt.gz", "north/e.laz"):
        (folder / name).touch()
    return folder


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        (["a.laz"], "a_mlsroad"),
        (["b, c.laz"], "b, c_mlsroad"),
        (["c.copc.laz"], "c_mlsroad"),
        (["d.txt.gz"], "d_mlsroad"),
        (["north"], "north_mlsroad"),
        (["a.laz", "c.copc.laz"], "street_mlsroad"),
        (["a.laz", "north/e.laz"], "street_mlsroad"),
        (["north/*.laz"], "north/north_mlsroad"),
        (["*.laz"], "street_mlsroad"),
        (["missing.laz"], "missing_mlsroad"),
    ],
)
def test_results_lie_beside_the_survey_in_a_folder_of_their_own(street, names, expected):
    assert default_output([str(street / name) for name in names]) == street / expected


def test_places_are_absolute_and_may_begin_at_home(monkeypatch, tmp_path):
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    assert expanded(["~/a.laz", "b.laz", "../c"]) == [
        str(tmp_path / "a.laz"),
        str(tmp_path / "b.laz"),
        str(tmp_path.parent / "c"),
    ]


def test_parameters_are_nested_by_their_dots_and_typed():
    assert nested(["label.read.delimiter=;", "ingest.scene_length=20.5", "label.copc=true"]) == {
        "label": {"read": {"delimiter": ";"}, "copc": True},
        "ingest": {"scene_length": 20.5},
    }
    assert nested(["label.read.units=m", "label.survey=/x/a,b.laz"])["label"]["survey"] == "/x/a,b.laz"


@pytest.mark.parametrize("text", ["label.copc", "=3", "label..copc=1", ".=1"])
def test_a_parameter_without_a_name_or_a_value_is_an_error(text):
    with pytest.raises(typer.BadParameter, match="must have the form SECTION.KEY=VALUE"):
        nested([text])


def test_two_parameters_in_one_option_are_an_error_but_commas_of_values_are_not():
    with pytest.raises(typer.BadParameter, match="give pulse_rate with a --params of its own"):
        nested(["with_images=false,pulse_rate=1000"])
    assert nested(["label.survey=/x/a,b=1.laz"])["label"]["survey"] == "/x/a,b=1.laz"
    assert nested(["label.read.delimiter=','", "x={a: 'b,c=d'}"])["x"] == {"a": "b,c=d"}


@pytest.mark.parametrize("value", ["{", "'", "*x", "!!python/object:os.system", "@x"])
def test_a_value_that_is_no_yaml_is_a_wrong_command_line(value):
    with pytest.raises(typer.BadParameter, match="is not a YAML value"):
        nested([f"label.scheme={value}"])


@pytest.mark.parametrize("value", ["{x:1}", "[{a: 2}, {x:1}]", "{a: {x:1}}"])
def test_a_missing_blank_after_a_colon_is_named(value):
    with pytest.raises(typer.BadParameter, match="'x:1' needs a blank after its colon"):
        nested([f"label.read.columns={value}"])
    assert nested(["label.read.columns={x: 1, 'a:b': 2}"])["label"]["read"]["columns"] == {"x": 1, "a:b": 2}


def test_the_survey_and_the_output_are_no_parameters():
    with pytest.raises(typer.BadParameter, match="label.survey is given as FILE"):
        nested(["label.survey=b.laz"], given={"label.survey": "FILE"})


@pytest.mark.parametrize("name", ["${a}.laz", "\\${a}.laz", "a${.laz", "$a.laz"])
def test_a_name_with_a_dollar_is_no_interpolation(name):
    config = OmegaConf.create({"survey": survey_of([name])})
    assert OmegaConf.to_container(config, resolve=True) == {"survey": name}


def test_merging_keeps_what_a_change_does_not_name():
    base = {"label": {"survey": "a", "read": {"units": "m"}}, "x": 1}
    assert merged(base, {"label": {"read": {"delimiter": ";"}}}) == {
        "label": {"survey": "a", "read": {"units": "m", "delimiter": ";"}},
        "x": 1,
    }
    assert base["label"]["read"] == {"units": "m"}


def test_the_root_folder_has_a_name_too():
    assert default_output(["/"]) == Path("/survey_mlsroad")


def test_kernels_in_the_cache_folder_count_as_compiled(monkeypatch, tmp_path):
    monkeypatch.setattr(session, "files", lambda _: tmp_path / "package")
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "cache"))
    assert not session.compiled_kernels()
    kernel = tmp_path / "cache" / "supervoxels_1" / "growth.grow-10.py311.nbi"
    kernel.parent.mkdir(parents=True)
    kernel.touch()
    assert session.compiled_kernels()


@pytest.mark.parametrize(
    "line",
    [
        ["label", "s3://bucket/a.laz"],
        ["label", "{there}", "-o", "s3://bucket/out"],
        ["inspect", "s3://bucket/a.laz"],
        ["simulate", "-o", "s3://bucket/out"],
        ["score", "s3://b/i.gpkg", "--truth", "t.csv"],
        ["open", "s3://b/out"],
    ],
)
def test_an_address_is_refused_before_any_work(tmp_path, monkeypatch, capsys, line):
    from typer.testing import CliRunner

    from mlsroad_pipeline.commands.app import app

    monkeypatch.chdir(tmp_path)
    (tmp_path / "there.laz").touch()
    done = CliRunner().invoke(app, [part.format(there=tmp_path / "there.laz") for part in line])
    said = done.stderr or str(done.exception)
    assert done.exit_code == 1 and "an address: this takes a file or folder" in said, said
    assert len(said.strip().splitlines()) == 1
    assert [path.name for path in tmp_path.iterdir()] == ["there.laz"]


def test_names_that_look_like_addresses_are_folders():
    assert expanded(["./s3:/b", "C:/x", "a:b"]) == [str(Path.cwd() / name) for name in ("s3:/b", "C:/x", "a:b")]


@pytest.mark.parametrize(
    ("kind", "name"),
    [
        ("model_datasets.ModelBundleDataset", "m"),
        ("inventory_dataset.RoadInventoryDataset", "i.gpkg"),
    ],
)
def test_datasets_of_local_files_refuse_addresses(kind, name):
    from kedro.io import AbstractDataset, DatasetError

    config = {"type": f"mlsroad_pipeline.datasets.{kind}", "filepath": f"s3://bucket/{name}"}
    with pytest.raises(DatasetError, match=f"filepath is 's3://bucket/{name}', an address"):
        AbstractDataset.from_config("data", config)


def test_a_labelled_survey_stands_for_the_folder_of_its_results(tmp_path):
    survey, results = str(tmp_path / "street.laz"), str(tmp_path / "street_mlsroad")
    assert results_folder(survey) == survey  # not labelled
    (tmp_path / "street_mlsroad" / ".mlsroad").mkdir(parents=True)
    assert results_folder(survey) == results_folder(results) == results

"""Configuration files read by libyaml have the values that Kedro's loader gives."""

import io

import pytest
from kedro.config import OmegaConfigLoader
from omegaconf import OmegaConf

from mlsroad_pipeline.config.loader import PlainFilesLoader, _read_files

PARAMETERS = """
_place: /data
label: {survey: street.laz, output: "${_place}/out"}
inspect: {survey: "${label.survey}"}
ingest: {lengths: [1.0, 2], on: "yes", none: null}
"""
CATALOG = """
_csv: {type: pandas.CSVDataset}
one: {type: "${_csv.type}", filepath: a.csv}
two: {type: pandas.CSVDataset, filepath: b.csv}
"""


@pytest.mark.parametrize("kind", ["parameters", "catalog"])
def test_references_between_sections_are_those_of_kedro(tmp_path, kind):
    for folder in ("base", "local"):
        (tmp_path / folder).mkdir()
    (tmp_path / "base/parameters.yml").write_text(PARAMETERS, encoding="utf-8")
    (tmp_path / "base/catalog.yml").write_text(CATALOG, encoding="utf-8")
    settings = {"base_env": "base", "default_run_env": "local"}
    expected = OmegaConfigLoader(str(tmp_path), **settings)[kind]
    found = PlainFilesLoader(str(tmp_path), **settings)[kind]
    assert found == expected
    assert "street.laz" in str(found) or found["one"]["type"] == "pandas.CSVDataset"


GLOBALS = """
execution: {backend: loky, n_workers: null}
place: /data
"""
SETTINGS = """
store:
  backend: ${runtime_params:execution.backend,${globals:execution.backend}}
  n_workers: ${runtime_params:execution.n_workers,${globals:execution.n_workers}}
  path: ${runtime_params:path,${globals:place}}
  file: ${globals:place}/a.csv
"""


@pytest.mark.parametrize(
    "given", [{}, {"execution": {"n_workers": 3}}, {"execution": {"backend": None}}, {"path": "/other"}]
)
def test_runtime_parameters_with_globals_as_defaults_are_those_of_kedro(tmp_path, given):
    for folder in ("base", "local"):
        (tmp_path / folder).mkdir()
    (tmp_path / "base/globals.yml").write_text(GLOBALS, encoding="utf-8")
    (tmp_path / "base/catalog.yml").write_text(SETTINGS, encoding="utf-8")
    settings = {"base_env": "base", "default_run_env": "local", "runtime_params": given}
    expected = OmegaConfigLoader(str(tmp_path), **settings)["catalog"]
    assert PlainFilesLoader(str(tmp_path), **settings)["catalog"] == expected
    assert expected["store"]["file"] == "/data/a.csv"


SCALARS = """
a: [1e-3, 1E5, .5, 1_000.5, 12, 0x1f, 0o17, 1:30:45.5, .inf, -.INF, .nan, 1., 1e+3, +7]
b: [2020-01-01, 2020-01-01T10:00:00Z, yes, on, "off", null, ~, 1.2.3, "1e-3", text]
"""


def test_yaml_has_the_rules_of_omegaconf(tmp_path):
    (tmp_path / "parameters.yml").write_text(SCALARS, encoding="utf-8")
    (found,) = _read_files(tmp_path, ["*.yml"]).values()
    expected = OmegaConf.to_container(OmegaConf.load(io.StringIO(SCALARS)))
    assert repr(found) == repr(expected) and found["b"][0] == "2020-01-01"


def test_a_file_with_a_key_twice_is_left_to_kedro(tmp_path):
    (tmp_path / "parameters.yml").write_text("a: 1\na: 2\n", encoding="utf-8")
    assert _read_files(tmp_path, ["*.yml"]) is None

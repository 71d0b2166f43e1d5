"""Private interfaces of libraries that this project uses: a release that changes one is named before anything else fails.

Each stands beside its measured gain, in the file that is named here.
"""

import inspect
from importlib.metadata import version

import pytest
from kedro.config import OmegaConfigLoader
from kedro.framework.context import KedroContext
from kedro.framework.project import pipelines

from mlsroad_pipeline.config.loader import PlainFilesLoader

METHODS = {
    "_read_dir_configs": "self conf_path patterns key processed_files read_environment_variables",
    "_check_duplicates": "self key config_per_file",
    "_merge_and_resolve": "self key config_per_file",
    "_read_raw_config": "self key",
    "_soft_merge": "config env_config env_path",
}


@pytest.mark.parametrize(("name", "arguments"), METHODS.items())
def test_methods_of_the_configuration_loader(name, arguments):
    where = f"kedro {version('kedro')} changes OmegaConfigLoader.{name}: adapt config/loader.py and config/loader.py"
    assert hasattr(OmegaConfigLoader, name), where
    assert list(inspect.signature(getattr(OmegaConfigLoader, name)).parameters) == arguments.split(), where


def test_the_configuration_loader_has_the_attributes_that_are_read(tmp_path):
    loader = OmegaConfigLoader(str(tmp_path), base_env="base", default_run_env="local", runtime_params={"a": 1})
    where = f"kedro {version('kedro')} changes OmegaConfigLoader: adapt config/loader.py"
    assert loader._protocol == "file" and loader.runtime_params == {"a": 1} and hasattr(loader, "_globals"), where
    assert issubclass(PlainFilesLoader, OmegaConfigLoader)


def test_requested_pipelines_of_kedro():
    where = f"kedro {version('kedro')} changes pipelines._requested_pipelines: adapt pipeline_registry.py"
    assert hasattr(pipelines, "_requested_pipelines") and hasattr(pipelines, "set_requested"), where
    before = pipelines._requested_pipelines
    pipelines.set_requested(["label"])
    try:
        assert pipelines._requested_pipelines == ["label"], where
    finally:
        pipelines.set_requested(before)


def test_parameters_of_kedros_context():
    where = f"kedro {version('kedro')} changes KedroContext._get_parameters: adapt commands/session.py"
    assert list(inspect.signature(KedroContext._get_parameters).parameters) == ["self"], where


def test_option_of_ezdxf_for_drawings_without_dates():
    where = (
        f"ezdxf {version('ezdxf')} changes options.write_fixed_meta_data_for_testing: adapt inventory_files/drawing.py"
    )
    import ezdxf

    assert ezdxf.options.write_fixed_meta_data_for_testing is False, where

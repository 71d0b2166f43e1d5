"""Configuration loader: checked names of parameters, catalogs that refer to them, and the layer of each data set."""

import json
import re
from collections.abc import Mapping
from copy import deepcopy
from pathlib import Path
from typing import Any

import click
from omegaconf import OmegaConf

from mlsroad_pipeline.config.plain_files import PlainFilesLoader
from mlsroad_pipeline.execution.parameter_checks import check_names, check_paths, merged
from mlsroad_pipeline.execution.run_identity import absolute, run_folder, run_settings

_Read = tuple[dict[Path, Any], dict[Path, Any], str, str, set[Path]]
"""Files of the base environment and of another one, both folders, and all files."""
_LAYER = re.compile(r"data/(\d\d_\w+?)(/|$)")


def with_layers(catalog: Mapping[str, Any]) -> dict[str, Any]:
    """Add the layer of each entry, the first folder of its path below ``data``, as metadata for `kedro viz`.

    Examples
    --------
    >>> with_layers({"ground": {"filepath": "data/03_primary/ground.csv"}})["ground"]["metadata"]
    {'kedro-viz': {'layer': '03_primary'}}
    """
    layered = dict(catalog)
    for name, entry in catalog.items():
        match = _LAYER.match(str(entry.get("filepath", ""))) if isinstance(entry, Mapping) else None
        if match:
            layered[name] = {"metadata": {"kedro-viz": {"layer": match[1]}}, **entry}
    return layered


def check_environment(conf_source: str, env: str | None) -> None:
    """End the command with one line if an environment has no folder, of which Kedro would read nothing."""
    place = Path(conf_source)
    known = sorted(path.name for path in place.iterdir() if path.is_dir()) if place.is_dir() else []
    if env and known and env not in known:
        raise click.ClickException(f"unknown environment {env!r} (known: {', '.join(known)})")


class ParameterConfigLoader(PlainFilesLoader):
    """Kedro's configuration loader with checked names of parameters and resolvers in catalogs.

    A section or a key that the base environment lacks is an error.
    """

    def __init__(self, conf_source: str, **options: Any) -> None:
        check_environment(conf_source, options.get("env"))
        if not Path(conf_source, options.get("default_run_env") or "").is_dir():  # the package has no `local`
            options["default_run_env"] = options["base_env"]
        super().__init__(conf_source, **options)
        self._parameters: dict[str, Any] | None = None  # cached for the catalog and the nodes

    def __getitem__(self, key: str) -> dict[str, Any]:
        """Return the configuration of a kind, such as ``"parameters"``."""
        if key == "parameters":
            if self._parameters is None:
                self._parameters = super().__getitem__(key)
                check_paths(self._parameters, self.runtime_params or {})
            return deepcopy(self._parameters)
        if key == "catalog":
            parameters = self["parameters"]  # read first, since resolvers hide the cause of an error

            def value_of(name: str, default: Any = None) -> Any:
                value: Any = parameters
                for part in name.split("."):
                    value = value.get(part) if isinstance(value, Mapping) else None
                return default if value is None or value == "" else value

            # Resolvers are global to the process; this loader replaces those of an earlier session.
            OmegaConf.register_new_resolver("params", value_of, replace=True)
            OmegaConf.register_new_resolver("label_run", self._label_run, replace=True)
        loaded: dict[str, Any] = super().__getitem__(key)
        return with_layers(loaded) if key == "catalog" else loaded

    def _read_raw_config(self, key: str) -> _Read:
        """Read the files of a kind, and check the names of parameters."""
        read: _Read = super()._read_raw_config(key)
        if key == "parameters":
            base: dict[str, Any] = {}
            for config in read[0].values():
                base |= _sections(config)
            for path, config in read[1].items():
                check_names(_sections(config), base, str(path))
            check_names(self.runtime_params or {}, base, "--params")
        return read

    @staticmethod
    def _soft_merge(config: dict[str, Any], env_config: dict[str, Any], env_path: str | None = None) -> dict[str, Any]:
        """Return base values, replaced by those of an environment; both are resolved."""
        return merged(config, env_config)

    def _label_run(self, what: str) -> str:
        """Return the output or the folder of the configured run of `label`, or its settings as JSON."""
        parameters = self._parameters or self["parameters"]
        folder = run_folder(parameters)
        if what == "output":
            return "data/08_reporting/label" if folder is None else absolute(parameters["label"]["output"])
        if what == "folder":
            return "data/02_intermediate/label" if folder is None else str(folder)
        return json.dumps({} if folder is None else run_settings(parameters))


def _sections(config: Mapping[Any, Any]) -> dict[str, Any]:
    """Return the sections of a file, without the anchors that Kedro leaves out."""
    return {str(name): value for name, value in config.items() if not str(name).startswith("_")}

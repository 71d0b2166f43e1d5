"""Configuration loader: plain files, checked names of parameters, catalogs that refer to them, layers of data."""

import glob
import json
import re
from collections.abc import Iterable, Mapping
from copy import deepcopy
from pathlib import Path
from typing import Any

import click
import yaml
from kedro.config import OmegaConfigLoader
from omegaconf import OmegaConf

from mlsroad_pipeline.execution.parameter_checks import check_names, check_paths, merged
from mlsroad_pipeline.execution.run_identity import absolute, run_folder, run_settings

_PLAIN_KINDS = ("parameters", "catalog", "globals", "mlflow")
_GLOBAL = re.compile(r"(?<!\\)\$\{globals:(\w+)\}")
_RUNTIME_OR_GLOBAL = re.compile(r"\$\{runtime_params:([\w.]+), *\$\{globals:([\w.]+)\}\}")
_TARGET = re.compile(r"\$\{[^:}]*\}")  # without a resolver
_SUFFIXES = (".yml", ".yaml", ".json")


class _Loader(getattr(yaml, "CSafeLoader", yaml.SafeLoader)):  # type: ignore[misc]  # on libyaml where PyYAML has it
    """YAML with the rules of OmegaConf: numbers such as 1e-3 are floats, dates are texts, a key occurs once."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        names = [key.value for key, _ in node.value if key.tag == yaml.resolver.BaseResolver.DEFAULT_SCALAR_TAG]
        if len(set(names)) < len(names):
            raise yaml.constructor.ConstructorError(None, None, "found duplicate key", node.start_mark)
        mapping: dict[Any, Any] = super().construct_mapping(node, deep=deep)
        return mapping


_FLOAT = r"""^(?:[-+]?[0-9]+(?:_[0-9]+)*\.[0-9_]*(?:[eE][-+]?[0-9]+)?
    |[-+]?[0-9]+(?:_[0-9]+)*(?:[eE][-+]?[0-9]+)
    |\.[0-9]+(?:_[0-9]+)*(?:[eE][-+][0-9]+)?
    |[-+]?[0-9]+(?:_[0-9]+)*(?::[0-5]?[0-9])+\.[0-9_]*
    |[-+]?\.(?:inf|Inf|INF)
    |\.(?:nan|NaN|NAN))$"""
_DATE = "tag:yaml.org,2002:timestamp"
_Loader.add_implicit_resolver("tag:yaml.org,2002:float", re.compile(_FLOAT, re.VERBOSE), list("-+0123456789."))
_Loader.yaml_implicit_resolvers = {
    first: [(tag, pattern) for tag, pattern in resolvers if tag != _DATE]
    for first, resolvers in _Loader.yaml_implicit_resolvers.items()
}


def _has_target(value: Any) -> bool:
    """Return whether a value, or one inside it, refers to a value of the same configuration, as ``${label.survey}``."""
    if isinstance(value, str):
        return _TARGET.search(value) is not None
    if isinstance(value, Mapping):
        return any(map(_has_target, value.values()))
    return isinstance(value, list) and any(map(_has_target, value))


def _found(values: Mapping[str, Any], name: str) -> tuple[Any, ...]:
    """Return the value with a dotted name in a tuple, which is empty if there is none."""
    found: Any = values
    for part in name.split("."):
        if not isinstance(found, Mapping) or part not in found:
            return ()
        found = found[part]
    return (found,)


def _is_plain(value: Any) -> bool:
    """Return whether OmegaConf would resolve a value to itself."""
    return value is None or isinstance(value, bool | int) or (isinstance(value, str) and "$" not in value)


def _refers(value: Any) -> bool:
    """Return whether a value, or one inside it, refers to another value."""
    if isinstance(value, str):
        return "${" in value
    if isinstance(value, Mapping):
        return any(_refers(key) or _refers(item) for key, item in value.items())
    return isinstance(value, list) and any(map(_refers, value))


class PlainFilesLoader(OmegaConfigLoader):
    """Kedro's configuration loader, with the files of a kind as plain mappings.

    Files that this loader cannot read are left to Kedro's loader, which reports them.
    """

    def _read_dir_configs(
        self,
        conf_path: str,
        patterns: Iterable[str],
        key: str,
        processed_files: set[Path],
        read_environment_variables: bool | None = False,
    ) -> dict[Path, Any]:
        """Read the files of a kind in a folder."""
        patterns = list(patterns)
        folder = Path(conf_path)
        configs: dict[Path, Any] | None = None
        if key in _PLAIN_KINDS and not read_environment_variables and self._protocol == "file" and folder.is_dir():
            configs = _read_files(folder, patterns)
        if configs is None:
            given: dict[Path, Any] = super()._read_dir_configs(
                conf_path, patterns, key, processed_files, read_environment_variables
            )
            return {path: OmegaConf.to_container(config, resolve=False) for path, config in given.items()}
        processed_files.update(configs)
        self._check_duplicates(key, configs)
        return configs

    def _check_duplicates(self, key: str, config_per_file: dict[Path, Any]) -> None:
        """Leave files with a common section or entry to Kedro's check."""
        owners: dict[str, Path] = {}
        for path, config in config_per_file.items():
            for name in config:
                if not str(name).startswith("_") and owners.setdefault(name, path) != path:
                    wrapped = {file: OmegaConf.create(values) for file, values in config_per_file.items()}
                    super()._check_duplicates(key, wrapped)
                    return

    def _merge_and_resolve(self, key: str, config_per_file: dict[Path, Any]) -> dict[str, Any]:
        """Merge files, and resolve the sections or entries that refer to other values."""
        read: dict[str, Any] = {}
        for config in config_per_file.values():
            read = merged(read, config)
        if not config_per_file:
            return {}
        if key == "parameters":
            read = merged(read, self.runtime_params or {})
        if key == "catalog":
            read = {name: self._with_globals(value) if _refers(value) else value for name, value in read.items()}
        open_ones = {name: value for name, value in read.items() if _refers(value)}
        if any(_has_target(value) for value in open_ones.values()):
            open_ones = read  # the target may lie in any section
        resolved: dict[str, Any] = {}
        if open_ones:
            # Kedro merges the runtime parameters once more, in their place.
            resolved = super()._merge_and_resolve(key, {Path(): OmegaConf.create(open_ones)})
        if key != "parameters":
            read = {name: value for name, value in read.items() if not str(name).startswith("_")}
        return {name: resolved[name] if name in open_ones else value for name, value in read.items()}

    def _with_globals(self, value: Any) -> Any:
        """Return a value of a catalog with references to plain globals replaced; OmegaConf parses the others."""
        if isinstance(value, Mapping):
            return {key: self._with_globals(item) for key, item in value.items()}
        if isinstance(value, list):
            return [self._with_globals(item) for item in value]
        if not isinstance(value, str):
            return value
        reference = _RUNTIME_OR_GLOBAL.fullmatch(value)
        if reference and not _found(self.runtime_params or {}, reference[1]):
            default = _found(self._globals or {}, reference[2])
            if default and _is_plain(default[0]):
                return default[0]
        return _GLOBAL.sub(self._global, value)

    def _global(self, match: re.Match[str]) -> str:
        value = (self._globals or {}).get(match[1])
        return value if isinstance(value, str) and "$" not in value else match[0]


def _read_files(folder: Path, patterns: Iterable[str]) -> dict[Path, Any] | None:
    """Return the content of the files that match a pattern, or None if one is not a mapping in valid YAML."""
    found = {name for pattern in patterns for name in glob.glob(pattern, root_dir=folder, recursive=True)}
    configs: dict[Path, Any] = {}
    for name in sorted(found):
        path = folder / name
        if path.suffix not in _SUFFIXES or not path.is_file():
            continue
        try:
            content = yaml.load(path.read_text(encoding="utf-8"), Loader=_Loader)
        except (yaml.YAMLError, UnicodeDecodeError):
            return None
        if content is None:
            content = {}
        if not isinstance(content, dict):
            return None
        configs[path] = content
    return configs


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

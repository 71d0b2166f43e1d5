"""Configuration loader: catalogs may refer to parameters, and their entries carry the layer of their data."""

from __future__ import annotations

import re
from collections.abc import Mapping
from copy import deepcopy
from typing import Any

from kedro.config import OmegaConfigLoader
from omegaconf import OmegaConf

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


class ParameterConfigLoader(OmegaConfigLoader):
    """Kedro's configuration loader with an additional resolver in catalogs: ``${params:label.output,default}``.

    It resolves to the value of the parameter, whether set in the base, in the environment or on the command line
    (Kedro's ``runtime_params`` covers the command line only), or to the default if the parameter is missing, null or
    empty.

    Parameters
    ----------
    conf_source : str
        The folder of the configuration.
    **options : object
        Further arguments of `OmegaConfigLoader`.
    """

    def __init__(self, conf_source: str, **options: Any) -> None:
        super().__init__(conf_source, **options)
        self._parameters: dict[str, Any] | None = None  # cached for the catalog and the nodes

    def __getitem__(self, key: str) -> dict[str, Any]:
        """Return the configuration of a kind, such as ``"parameters"``."""
        if key == "parameters":
            if self._parameters is None:
                self._parameters = super().__getitem__(key)
            return deepcopy(self._parameters)
        if key == "catalog":

            def value_of(name: str, default: Any = None) -> Any:
                value: Any = self._parameters or self["parameters"]
                for part in name.split("."):
                    value = value.get(part) if isinstance(value, Mapping) else None
                return default if value is None or value == "" else value

            # Resolvers are global to the process; this loader replaces the one of an earlier session.
            OmegaConf.register_new_resolver("params", value_of, replace=True)
        loaded: dict[str, Any] = super().__getitem__(key)
        return with_layers(loaded) if key == "catalog" else loaded

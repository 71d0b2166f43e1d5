"""How configuration is loaded: catalogs may refer to parameters, and their entries know the layer of their data."""

from __future__ import annotations

import re
from collections.abc import Mapping
from copy import deepcopy
from typing import Any

from kedro.config import OmegaConfigLoader
from omegaconf import OmegaConf

_LAYER = re.compile(r"data/(\d\d_\w+?)(/|$)")


def with_layers(catalog: Mapping[str, Any]) -> dict[str, Any]:
    """Tell `kedro viz` the layer of each entry, which is the first folder of its path below ``data``.

    Examples
    --------
    >>> with_layers({"ground": {"filepath": "data/03_primary/ground.csv"}})["ground"]["metadata"]
    {'kedro-viz': {'layer': '03_primary'}}
    """
    found = dict(catalog)
    for name, entry in catalog.items():
        match = _LAYER.match(str(entry.get("filepath", ""))) if isinstance(entry, Mapping) else None
        if match:
            found[name] = {"metadata": {"kedro-viz": {"layer": match[1]}}, **entry}
    return found


class ParameterConfigLoader(OmegaConfigLoader):
    """Kedro's loader with one more resolver in catalogs: ``${params:label.output,default}``.

    It gives the parameter's value wherever that was set, in the base, in the environment or on the command line
    (Kedro's own ``runtime_params`` knows the command line alone), and the default where the parameter is missing, null
    or empty.

    Parameters
    ----------
    conf_source : str
        The folder of the configuration.
    **options : object
        Further arguments of `OmegaConfigLoader`.
    """

    def __init__(self, conf_source: str, **options: Any) -> None:
        super().__init__(conf_source, **options)
        self._parameters: dict[str, Any] | None = None  # read once for the catalog and for the nodes

    def __getitem__(self, key: str) -> dict[str, Any]:
        """Load the configuration of a kind."""
        if key == "parameters":
            if self._parameters is None:
                self._parameters = super().__getitem__(key)
            return deepcopy(self._parameters)
        if key == "catalog":

            def value_of(name: str, default: Any = None) -> Any:
                found: Any = self._parameters or self["parameters"]
                for part in name.split("."):
                    found = found.get(part) if isinstance(found, Mapping) else None
                return default if found is None or found == "" else found

            # Resolvers are global to the process: that of the loader which loads its catalog now is the right one.
            OmegaConf.register_new_resolver("params", value_of, replace=True)
        loaded: dict[str, Any] = super().__getitem__(key)
        return with_layers(loaded) if key == "catalog" else loaded

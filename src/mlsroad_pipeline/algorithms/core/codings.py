"""Codings: codes of a dataset to classes of the taxonomy.

A *coding* maps the codes of a dataset to taxonomy codes when a survey is read. Codings are configuration.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY, unknown_codes
from mlsroad_pipeline.algorithms.core.exceptions import ParameterError


@dataclass(frozen=True)
class Coding:
    """Mapping of the label codes of a dataset to taxonomy classes."""

    name: str
    codes: Mapping[int, str]

    @classmethod
    def from_config(cls, name: str, config: Mapping[Any, str]) -> Coding:
        """Build a coding from configuration, whose codes may be text."""
        if not isinstance(config, Mapping):
            raise ParameterError(f"coding {name!r} must map codes to taxonomy classes, got {config!r}")
        try:
            return cls(name, {int(code): class_name for code, class_name in config.items()})
        except (TypeError, ValueError) as error:
            if isinstance(error, ParameterError):
                raise
            raise ParameterError(f"coding {name!r}: its codes must be whole numbers: {error}") from error

    def __post_init__(self) -> None:
        for code, class_name in self.codes.items():
            if not isinstance(class_name, str) or class_name not in TAXONOMY:
                raise ParameterError(f"coding {self.name!r}: code {code} names {class_name!r}, not in the taxonomy")

    def encode(self, codes: ArrayLike, *, source: str = "labels") -> NDArray[np.uint8]:
        """Map dataset codes to codes of `TAXONOMY`; `UnknownClassError` names an unknown code, its count and the
        source.
        """
        values = np.asarray(codes).astype(np.int64)
        known = np.array(sorted(self.codes), dtype=np.int64)
        taxonomy = np.array([TAXONOMY[self.codes[int(code)]] for code in known], dtype=np.uint8)
        if len(known) == 0 or not np.isin(values, known).all():
            raise unknown_codes(values, known, f"coding {self.name!r}", source)
        return taxonomy[np.searchsorted(known, values)]


CODE_NAMES = {
    **{0: "never classified", 1: "unclassified", 2: "ground", 3: "low vegetation", 4: "medium vegetation"},
    **{5: "high vegetation", 6: "building", 7: "low noise", 8: "model key point", 9: "water", 10: "rail"},
    **{11: "road surface", 13: "wire guard", 14: "wire conductor", 15: "transmission tower", 16: "wire connector"},
    **{17: "bridge deck", 18: "high noise"},
}
"""Code to name; codes from 64 are free for producers of data."""

NOISE_CODES = (7, 18)
"""Codes of noise."""

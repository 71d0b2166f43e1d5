"""LAS codes that `label` writes for the classes of a model, and their names."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.las_codes import CODE_NAMES
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle, bundle_scheme

UNCLASSIFIED, NOISE = 1, 7
"""LAS codes of points without a class and of outliers."""

PRIVATE = 64
"""First LAS code that producers of data may define."""


def point_codes(codes: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the LAS code of each value of `CoreLabels.label`: those of the classes, unclassified, noise."""
    return np.append(codes, np.array([UNCLASSIFIED, NOISE], dtype=np.uint8))


def output_codes(bundle: ModelBundle, scheme: str, schemes: Mapping[str, Any]) -> NDArray[np.uint8]:
    """Return the LAS code of each class of a model."""
    trained = bundle_scheme(bundle)
    if scheme == "asprs":
        return trained.codes()
    if scheme not in schemes:
        raise ParameterError(f"label.scheme {scheme!r} is not configured (schemes: {', '.join(schemes)})")
    return trained.codes(ClassScheme.from_config(scheme, schemes[scheme]))


def code_names(bundle: ModelBundle, scheme: str, schemes: Mapping[str, Any]) -> dict[int, str]:
    """Return the names of the LAS codes that are written: standard ones, and those of the classes from 64."""
    codes = output_codes(bundle, scheme, schemes)
    private: dict[int, list[str]] = {}
    if scheme == "asprs":
        for name, code in zip(bundle_scheme(bundle).classes, codes.tolist(), strict=True):
            private.setdefault(code, []).append(name)
    else:
        private = {
            k + PRIVATE: [name] for k, name in enumerate(ClassScheme.from_config(scheme, schemes[scheme]).classes)
        }
    written = sorted({*codes.tolist(), UNCLASSIFIED, NOISE})
    return {code: CODE_NAMES[code] if code in CODE_NAMES else "/".join(private[code]) for code in written}

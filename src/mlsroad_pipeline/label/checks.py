"""Checks before the labelling that the results of each file can be written."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from pyproj import CRS
from pyproj.exceptions import CRSError

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.datasets.inventory.vector_files import prj_text, to_wgs84
from mlsroad_pipeline.execution.collection import SceneCollection
from mlsroad_pipeline.formats.las.copc import POINT_FORMATS
from mlsroad_pipeline.formats.las.header import LasHeader
from mlsroad_pipeline.formats.registry import get_format
from mlsroad_pipeline.label.inventory import survey_crs
from mlsroad_pipeline.label.writer import result_header
from mlsroad_pipeline.surveys.parameters import LabelParameters
from mlsroad_pipeline.surveys.plan import PlannedFile, SurveyPlan

LIMIT = 2**31 - 1
"""Largest coordinate of LAS in steps of its scale."""


def check_outputs(plan: SurveyPlan, files: SceneCollection, quality: pd.DataFrame, parameters: LabelParameters) -> None:
    """Check that LAZ, copies and inventory can be written, from headers, extents and reference systems.

    Raises DataError for column names and types that LAS cannot hold, coordinates outside of 32 bits at the scale of the
    result, waveforms in a cloud-optimised copy, and reference systems that differ, are not understood, or cannot be
    written in a format of `label.export`.
    """
    _check_crs(survey_crs(plan, files), plan.files[0].source.path, parameters.export)
    rows = {str(row["source"]): row for row in quality.to_dict("records")}
    for file in plan.files:
        check_file(file, plan, rows[file.source.name], copc=parameters.copc)


def check_file(file: PlannedFile, plan: SurveyPlan, row: Mapping[Any, Any], *, copc: bool) -> None:
    """Check that the results of one file can be written; `row` has its extent."""
    path = Path(file.source.path)
    form = get_format(path)
    header = result_header(path, form, plan.options)
    if form.name != "LAS":  # LAS keeps its scale and offset
        _check_extent(path, header, row)
    if copc and header.point_format not in POINT_FORMATS:
        raise DataError(
            f"{path} has points of format {header.point_format} with waveforms, which COPC cannot hold; "
            "set label.copc=false"
        )


def _check_extent(path: Path, header: LasHeader, row: Mapping[Any, Any]) -> None:
    for axis, name in enumerate("xyz"):
        ends = np.array([row[f"min_{name}"], row[f"max_{name}"]])
        steps = np.abs(ends - header.offset[axis]) / header.scale[axis]
        if (steps > LIMIT).any():
            worst, scale = ends[steps.argmax()], header.scale[axis]
            raise DataError(
                f"{path}: {name} {worst:.10g} lies more than {LIMIT * scale:.0f} from the first point, "
                f"the limit of LAZ at a scale of {scale:g}; remove that point or set label.read.units"
            )


def _check_crs(crs: str | None, path: str, export: Sequence[str]) -> None:
    try:
        known = None if crs is None else CRS.from_user_input(crs)
    except CRSError as error:
        text = crs if crs is None or len(crs) <= 80 else f"{crs[:77]}..."
        raise DataError(f"{path}: its coordinate reference system {text!r} is not understood") from error
    if "geojson" in export:
        to_wgs84(known, path)
    if known is not None and {"csv", "shapefile", "dxf"}.intersection(export):
        prj_text(known, path)

"""Checks before the labelling: device of the model, and whether the results of each file can be written."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from shlex import quote
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from pyproj import CRS
from pyproj.exceptions import CRSError

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError, ReadError
from mlsroad_pipeline.algorithms.core.plain_text import shortened
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.models.labelling import member
from mlsroad_pipeline.algorithms.models.methods import METHODS
from mlsroad_pipeline.algorithms.quality.report import QualityReport
from mlsroad_pipeline.execution.collection import SceneCollection
from mlsroad_pipeline.formats.base import BY_CRS, ReadOptions
from mlsroad_pipeline.formats.crs import crs_units
from mlsroad_pipeline.formats.las.copc import POINT_FORMATS
from mlsroad_pipeline.formats.las.header import LasHeader
from mlsroad_pipeline.formats.registry import get_format
from mlsroad_pipeline.inventory_files.vector_files import prj_text, to_wgs84
from mlsroad_pipeline.label.inventory import read_sections, survey_crs
from mlsroad_pipeline.label.writer import keeps_units, result_header
from mlsroad_pipeline.surveys.parameters import LabelParameters
from mlsroad_pipeline.surveys.plan import PlannedFile, SurveyPlan
from mlsroad_pipeline.surveys.reading import options_in_use
from mlsroad_pipeline.surveys.survey_warnings import LONG, looks_like_degrees

NO_LENGTHS = {"geographic": "coordinates in degrees", "geocentric": "geocentric coordinates, without heights"}
"""Kinds of systems that points are not labelled in."""

NONE_USED = "all points are flagged withheld or have a class of noise: there is nothing to label"
NONE_LABELLED = (
    "all points are flagged withheld or have a class of noise: none is labelled, and label refuses a survey of such "
    "files alone"
)

LIMIT = 2**31 - 1
"""Largest coordinate of LAS in steps of its scale."""

HIGH = 2000.0
"""Range of heights in metres above which whole numbers are taken for another unit."""


def check_headers(plan: SurveyPlan, parameters: LabelParameters) -> None:
    """Check from the headers, before any point is read, that the results of all files can be written."""
    passes = plan.passes()
    if parameters.sections is not None and len(passes) > 1:
        raise ParameterError(
            f"label.sections has stations of one path, but the survey has {len(passes)} passes ({_some(passes)}): "
            "label them one at a time, or leave it out"
        )
    for file in plan.files:
        with suppress(ReadError):  # damaged: the reading reports it, after the files that can be read
            check_header(file.source.path, plan.options, copc=parameters.copc)


def _some(passes: Mapping[str, Sequence[PlannedFile]]) -> str:
    names = [str(Path(files[0].source.path).parent) for files in passes.values()]
    return ", ".join(names[:2]) + (", ..." if len(names) > 2 else "")


def check_header(path: str, options: ReadOptions, *, copc: bool = False) -> None:
    """Check from its header that the results of one file can be written."""
    form = get_format(path)
    _check_crs(form.info(Path(path), replace(options, reproject=None)).crs, path, options)
    header = result_header(Path(path), form, options)
    if copc and header.point_format not in POINT_FORMATS:
        raise DataError(
            f"{path} has points of format {header.point_format} with waveforms, which COPC cannot hold; "
            "set label.copc=false"
        )


def output_problems(path: str, options: ReadOptions, quality: QualityReport) -> list[str]:
    """Return why `label` would refuse a file that can be read, or would label no point of it.

    The reasons depend on its header, the extent of its points and the numbers of withheld points and noise.
    """
    ends = (("min", quality.low), ("max", quality.high))
    row = {f"{end}_{axis}": value for end, values in ends for axis, value in zip("xyz", values, strict=True)}
    form = get_format(path)
    try:
        check_header(path, options)
        if form.info(Path(path), options).crs is None:
            _check_degrees(row, path)
        _check_room(path, options, row, options_in_use(form, path, options).factors)
    except DataError as error:
        return [f"label refuses it: {str(error).removeprefix(path).lstrip(': ')}"]
    return [NONE_LABELLED] if 0 < quality.n_points == quality.n_withheld + quality.n_noise else []


def check_outputs(plan: SurveyPlan, files: SceneCollection, quality: pd.DataFrame, parameters: LabelParameters) -> None:
    """Check that LAZ, copies and inventory can be written, from headers, extents and reference systems."""
    crs = survey_crs(plan, files)
    _check_exports(crs, plan.files[0].source.path, parameters.export)
    if parameters.sections is not None:
        read_sections(Path(parameters.sections))
    facts = files.load_all("info")
    rows = {str(row["source"]): row for row in quality.to_dict("records")}
    if sum(row["n_points"] - row["n_withheld"] - row["n_noise"] for row in rows.values()) <= 0:
        raise DataError(f"{plan.files[0].source.path}: {NONE_USED}")
    for file in plan.files:
        if crs is None:
            _check_degrees(rows[file.source.name], file.source.path)
        if facts[file.key]["whole_numbers"][0] and plan.options.units == BY_CRS:
            check_whole_numbers(rows[file.source.name], file.source.path)
        check_file(file, plan, rows[file.source.name], copc=parameters.copc, factors=facts[file.key]["factors"])


def check_file(
    file: PlannedFile,
    plan: SurveyPlan,
    row: Mapping[Any, Any],
    *,
    copc: bool,
    factors: NDArray[np.float64] | None = None,
) -> None:
    """Check that the results of one file can be written; `row` has its extent in metres, `factors` are its units."""
    check_header(file.source.path, plan.options, copc=copc)
    _check_room(file.source.path, plan.options, row, factors)


def _check_room(path: str, options: ReadOptions, row: Mapping[Any, Any], factors: NDArray[np.float64] | None) -> None:
    """Check that coordinates fit into the result of a file; LAS keeps its scale and offset."""
    form = get_format(path)
    if form.name != "LAS":
        units = np.ones(3) if factors is None or not keeps_units(options) else factors
        _check_extent(Path(path), result_header(Path(path), form, options), row, units)


def _check_extent(path: Path, header: LasHeader, row: Mapping[Any, Any], factors: NDArray[np.float64]) -> None:
    for axis, name in enumerate("xyz"):
        ends = np.array([row[f"min_{name}"], row[f"max_{name}"]]) / factors[axis]
        with np.errstate(over="ignore"):
            steps = np.abs(ends - header.offset[axis]) / header.scale[axis]
        if (steps > LIMIT).any():
            scale, extent = header.scale[axis], f"{ends[0]:.10g} to {ends[1]:.10g}"
            raise DataError(
                f"{path}: {name} is {extent}, more than {LIMIT * scale:.0f} from the first point, "
                f"the limit of LAZ at a scale of {scale:g}; remove stray points or set label.read.units"
            )


def _check_degrees(row: Mapping[Any, Any], path: str) -> None:
    low, high = (np.array([row[f"{end}_{axis}"] for axis in "xyz"]) for end in ("min", "max"))
    if looks_like_degrees(low, high):
        longitude, latitude = low[:2]
        exchange = " ".join(f"--params label.read.columns.{axis}={n}" for axis, n in (("x", 1), ("y", 0), ("z", 2)))
        exchanged = "" if abs(longitude) > 90 else (
            f"; if x is the latitude: {exchange} --crs EPSG:4326 --params label.read.reproject="
            f"{_utm_zone(latitude, longitude)}"
        )  # fmt: skip
        raise DataError(
            f"{path}: its coordinates look like degrees, {longitude:.6f} to {high[0]:.6f}: mlsroad label {quote(path)} "
            f"--crs EPSG:4326 --params label.read.reproject={_utm_zone(longitude, latitude)}{exchanged}; or set "
            "label.read.units if they are not degrees"
        )


def _utm_zone(longitude: float, latitude: float) -> str:
    """Return the code of the zone of UTM on WGS 84 at a place in degrees."""
    zone = int((longitude + 180.0) // 6.0) % 60 + 1
    return f"EPSG:{32600 if latitude >= 0 else 32700}".removesuffix("00") + f"{zone:02d}"


def check_whole_numbers(row: Mapping[Any, Any], path: str) -> None:
    """Raise DataError for whole numbers over an extent that no file has in metres."""
    extent = np.array([row[f"max_{axis}"] - row[f"min_{axis}"] for axis in "xyz"])
    if extent[:2].max() > LONG or extent[2] > HIGH:
        raise DataError(
            f"{path}: its coordinates are whole numbers over {extent[:2].max():,.0f} in plan and {extent[2]:,.0f} in "
            "height: set label.read.units=millimetre or centimetre, or metre if they are metres"
        )


def _check_crs(crs: str | None, path: str, options: ReadOptions) -> None:
    if crs is None:
        return
    try:
        system = CRS.from_user_input(crs)
    except CRSError as error:
        raise DataError(
            f"{path}: its coordinate reference system {shortened(crs)!r} is not understood; set label.crs, such as "
            "EPSG:25832"
        ) from error
    units = crs_units(crs)
    if options.reproject is None and units is not None and units.kind in NO_LENGTHS:
        raise DataError(
            f"{path}: its coordinate reference system {system.name} has {NO_LENGTHS[units.kind]}; set "
            "label.read.reproject to a system in metres, such as EPSG:25832, or label.crs if it is wrong"
        )


def _check_exports(crs: str | None, path: str, export: Sequence[str]) -> None:
    known = None if crs is None else CRS.from_user_input(crs)
    if "geojson" in export:
        to_wgs84(known, path)
    if known is not None and {"csv", "shapefile", "dxf"}.intersection(export):
        prj_text(known, path)


_IMAGES = "image_labels"


def check_device(bundle: ModelBundle) -> None:
    """Raise ParameterError for a device that is missing, and warn of a GPU that fails; workers print no warnings."""
    for source, device in _devices(bundle):
        if source == "onnx":
            METHODS[_IMAGES].function(".segmentation:segmenter_of")(
                bundle if bundle.slug == _IMAGES else member(bundle, _IMAGES)
            )
        elif source != "masks" and (device == "cuda" or not version("torch").endswith("+cpu")):
            from mlsroad_pipeline.algorithms.models.machines.torch_training import find_device  # noqa: PLC0415  it imports torch

            find_device(device)


def _devices(bundle: ModelBundle) -> Iterator[tuple[str | None, str]]:
    """Yield the source of the segmentation, if there is one, and the device of each network of a model."""
    members: Mapping[str, Any] = bundle.metadata.get("members", {})
    for metadata in (bundle.metadata, *members.values()):
        parameters = metadata.get("parameters", {})
        recogniser = parameters.get("recogniser", {})
        for owner in (parameters, recogniser, recogniser.get("training", {})):
            if "device" in owner:
                yield metadata.get("segmentation", {}).get("source"), str(owner["device"])

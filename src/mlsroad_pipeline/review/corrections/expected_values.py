"""Values that an edited inventory may have: kinds, classes of the model, coordinate system of the output."""

from __future__ import annotations

from pathlib import Path

import pyogrio
from pyproj import CRS
from pyproj.exceptions import CRSError

from mlsroad_pipeline.algorithms.core.exceptions import ReadError
from mlsroad_pipeline.algorithms.inventory.objects.rules import KINDS
from mlsroad_pipeline.formats.las.header import read_header
from mlsroad_pipeline.formats.las.lookup import class_names
from mlsroad_pipeline.review.corrections.answers import NamedClasses
from mlsroad_pipeline.review.corrections.labelled_output import LabelledOutput


def known_names(folder: Path) -> frozenset[str]:
    """Return the kinds, and the names of classes that the model of an output can learn; kinds alone without a run."""
    try:
        output = LabelledOutput.at(folder)
        cloud = next(iter(output.clouds().values()))
    except ReadError:
        return frozenset(KINDS)
    scheme = output.model_scheme(class_names(read_header(cloud)))
    if scheme is None:
        classes = {name for spec in output.schemes.values() for name in spec["classes"]}
        return frozenset({*KINDS, *classes, *output.record["summary"].get("classes", ())})
    return frozenset({*KINDS, *NamedClasses(scheme, output.schemes).names})


def system_of(folder: Path) -> CRS | None:
    """Return the coordinate reference system of the inventory of an output, None if it has none."""
    path = folder / "inventory.gpkg"
    if not path.is_file():
        return None
    try:
        return _known(pyogrio.read_info(path, layer="objects")["crs"])
    except (pyogrio.errors.DataSourceError, pyogrio.errors.DataLayerError) as error:
        raise ReadError(f"{path}: not a GeoPackage inventory: {error}") from error


def _known(given: object) -> CRS | None:
    try:
        system = None if given is None else CRS.from_user_input(given)
    except CRSError:
        return None
    return None if system is None or "Undefined" in system.name else system


def is_other_system(given: object, system: CRS | None) -> bool:
    """Return whether both systems are known and their horizontal parts differ."""
    own = _known(given)
    if own is None or system is None:
        return False
    one, other = (crs.sub_crs_list[0] if crs.is_compound else crs for crs in (own, system))
    return not (one.equals(other, ignore_axis_order=True) or one.name == other.name)

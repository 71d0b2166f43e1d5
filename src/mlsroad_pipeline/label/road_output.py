"""Files of the measures of a road: tables, layers, page and sections across it."""

from pathlib import Path

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.formats.files import write_atomic
from mlsroad_pipeline.inventory_files.cross_sections import write_cross_section
from mlsroad_pipeline.inventory_files.geopackage import check_closed
from mlsroad_pipeline.inventory_files.road_files import LAYERS, SECTIONS, TABLE, write_road
from mlsroad_pipeline.label.road import MeasuredRoad
from mlsroad_pipeline.reporting.road_page import road_page

PAGE = "road.html"
"""Page of the measures."""


def check_target(folder: Path, *, overwrite: bool) -> None:
    """Raise ParameterError where files would be replaced that may not be."""
    if any((folder / name).exists() for name in (TABLE, SECTIONS, LAYERS, PAGE)) and not overwrite:
        raise ParameterError(
            f"{folder} holds measures of a road: name another folder with --output, or replace them with --overwrite"
        )
    check_closed(folder / LAYERS)


def write_measures(found: MeasuredRoad, folder: Path, *, survey: str, envelope: str | None) -> list[Path]:
    """Write all files, and return their paths; sections across the road of earlier runs stay."""
    folder.mkdir(parents=True, exist_ok=True)
    written = write_road(found.table, found.sections, found.path, found.crs, folder)
    write_atomic(folder / PAGE, road_page(found.table, found.sections, survey, envelope).encode())
    drawn = [path for section in found.across for path in write_cross_section(section, folder)]
    return [*written, folder / PAGE, *drawn]

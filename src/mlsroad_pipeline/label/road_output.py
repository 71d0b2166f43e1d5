"""Files of the measures of a road: tables, layers, page and sections across it."""

import re
from pathlib import Path

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.formats.files import write_atomic
from mlsroad_pipeline.inventory_files.cross_sections import write_cross_section
from mlsroad_pipeline.inventory_files.geopackage import check_closed
from mlsroad_pipeline.inventory_files.road_files import LAYERS, PLACES, SECTIONS, SIGNS, TABLE, write_road
from mlsroad_pipeline.label.result_files import check_folder
from mlsroad_pipeline.label.road import MeasuredRoad
from mlsroad_pipeline.reporting.road_page import road_page
from mlsroad_pipeline.review.compared_entries import inventory_digest
from mlsroad_pipeline.review.corrections.checked_states import with_checked
from mlsroad_pipeline.review.corrections.labelled_output import LabelledOutput

_SECTION = re.compile(r"section_\d{6}\.\d\d\.(csv|svg|dxf)")

PAGE = "road.html"
"""Page of the measures."""


def check_target(folder: Path, *, overwrite: bool) -> None:
    """Raise ParameterError where files would be replaced that may not be."""
    check_folder(folder)
    if any((folder / name).exists() for name in (TABLE, SECTIONS, SIGNS, PLACES, LAYERS, PAGE)) and not overwrite:
        raise ParameterError(
            f"{folder} holds measures of a road: name another folder with --output, or replace them with --overwrite"
        )
    check_closed(folder / LAYERS)


def write_measures(found: MeasuredRoad, folder: Path, *, survey: LabelledOutput, envelope: str | None) -> list[Path]:
    """Write all files, and return their paths; sections across the road of earlier measures go."""
    folder.mkdir(parents=True, exist_ok=True)
    if (folder / TABLE).exists():
        for path in folder.glob("section_*"):
            if _SECTION.fullmatch(path.name):
                path.unlink()
    tables = found._replace(places=with_checked(found.places, "road", survey.path))
    facts = {"inventory": inventory_digest(survey.record), "envelope": envelope}
    written = write_road(
        tables.table, tables.sections, tables.sight, tables.places, folder, path=found.path, crs=found.crs, facts=facts
    )
    page = road_page(found.table, found.sections, found.sight, str(survey.path), envelope)
    write_atomic(folder / PAGE, page.encode())
    drawn = [path for section in found.across for path in write_cross_section(section, folder)]
    return [*written, folder / PAGE, *drawn]

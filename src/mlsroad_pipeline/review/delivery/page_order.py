"""Delivery that was ordered on the page: files in a new folder below the output."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path
from typing import Any

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.review.delivery.catalogue import ITEM, VPC
from mlsroad_pipeline.review.delivery.files import ALL_POINTS, SUFFIXES, Delivery
from mlsroad_pipeline.review.page_server.output_folder import OutputFolder

FORMATS = (*SUFFIXES, VPC, ITEM)


def deliver_order(output: OutputFolder, wanted: dict[str, Any]) -> dict[str, Any]:
    """Write the corrected files of the formats that were ordered; return the folder and the names of the files."""
    formats = wanted.get("formats")
    if not isinstance(formats, list) or not formats or not all(suffix in FORMATS for suffix in formats):
        raise ParameterError(f"formats must be one or more of {', '.join(FORMATS)}")
    folder = output.path / f"delivery-{datetime.now():%Y%m%d-%H%M%S}"
    stem = Path(output.name).stem or "survey"
    single = len(output.clouds.files) == 1
    names = [ALL_POINTS if suffix == ".laz" and not single else f"{stem}{suffix}" for suffix in dict.fromkeys(formats)]
    delivery = Delivery(output.path, checked=bool(wanted.get("checked")))
    folder.mkdir()
    try:
        written = delivery.write([folder / name for name in names])
    finally:
        if not any(folder.iterdir()):
            folder.rmdir()
    return {
        "folder": str(folder),
        "files": [path.relative_to(folder).as_posix() for path in written],
        "objects": len(delivery.corrected.objects),
    }

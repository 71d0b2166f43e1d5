"""Page of a small survey as one self-contained HTML file: to look at only, without a server."""

import base64
import gzip
import hashlib
import html
import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import MlsRoadError
from mlsroad_pipeline.formats.files import atomic_file
from mlsroad_pipeline.review.corrections import has_corrections, review_order
from mlsroad_pipeline.review.corrections.listed_objects import INVENTORIES, read_objects
from mlsroad_pipeline.review.corrections.store import NAME as STORE
from mlsroad_pipeline.review.page_server.background import Background
from mlsroad_pipeline.review.page_server.cloud_files import CloudFiles
from mlsroad_pipeline.review.page_server.output_folder import INVENTORY, PHOTOS, OutputFolder, resolved
from mlsroad_pipeline.review.page_server.served_survey import ServedSurvey
from mlsroad_pipeline.review.page_server.server import STATIC
from mlsroad_pipeline.review.page_server.tile_format import FirstPicture, picture_of

MOST_POINTS = 1_000_000
"""Points of an exported page; of larger surveys it has a random sample."""
_BLOCK = 500_000
_ROOM = 20.0  # of the background around the survey, metres
_MOST_PHOTOS = 20_000_000  # bytes of all photos


class ExportError(MlsRoadError):
    """The page cannot be written to this file."""


def export_page(
    output: OutputFolder, target: Path, *, most: int = MOST_POINTS, background: Background | None = None
) -> Path:
    """Write the page of an output to one HTML file and return its path; an existing file is not replaced.

    Raises ExportError if the file exists, or its name does not end in ``.html``.
    """
    if target.suffix.lower() not in (".html", ".htm"):
        raise ExportError(f"{target}: the name of an exported page ends in .html")
    if target.exists():
        raise ExportError(f"{target} exists: remove it, or choose another name (--export)")
    if not target.parent.is_dir():
        raise ExportError(f"{target.parent} is not a folder: create it first")
    survey = ServedSurvey(output, user="", background=background)
    _check_inside(output)
    corrections, queue = _decisions(survey)
    picture = _sample(output.clouds, most)
    content = {
        "survey": survey.survey(picture),
        "corrections": corrections,
        "queue": queue,
        "photos": _photos(output.path),
        "background": None if background is None else background.embedded(_area(output.clouds, picture)),
    }
    survey.close()
    page = _page(json.dumps(content, allow_nan=False).encode(), picture.chunk, title=output.name)
    with atomic_file(target) as stream:
        stream.write(page.encode())
    return target


def _check_inside(output: OutputFolder) -> None:
    """Raise ExportError if a file of the output is elsewhere: the exported file would hold its content."""
    for name in (
        *output.cloud_names,
        *(name for name in (INVENTORY, STORE, *INVENTORIES) if (output.path / name).exists()),
    ):
        if resolved(output.path, name) is None:
            raise ExportError(f"{output.path / name} is not in the folder, but a link or path out of it: copy it there")


def _decisions(survey: ServedSurvey) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Return decisions and queue; a folder without decisions is left without their store."""
    if has_corrections(survey.output.path):
        return survey.corrections(points=False), survey.queue(100)
    none: dict[str, Any] = {"states": {}, "painted": [], "decisions": [], "objects": [], "codes": {}, "mark": ""}
    none |= {"lines": {"status": {}, "rows": [], "gone": []}, "notes": {}, "notes_of_added": {}, "counts": None}
    none["checked"] = {}
    return none, review_order(read_objects(survey.output.path).table, {}, 100)


def _sample(clouds: CloudFiles, most: int) -> FirstPicture:
    """Return random points of a survey, all of a small one."""
    generator, share = np.random.default_rng(0), most / max(1, clouds.n_points)
    xyz: list[NDArray] = []
    values: list[NDArray] = []
    for block in clouds.blocks(_BLOCK):
        kept = generator.random(len(block.xyz)) < share
        xyz.append(block.xyz[kept])
        values.append(block.values[kept])
    return picture_of(clouds, np.concatenate(xyz), np.concatenate(values))


def _area(clouds: CloudFiles, picture: FirstPicture) -> tuple[float, float, float, float]:
    """Return the extent of a survey in plan with some room."""
    low, high = (np.array(corner[:2]) + clouds.origin[:2] for corner in picture.facts["bounds"])
    return *(low - _ROOM).tolist(), *(high + _ROOM).tolist()


def _photos(folder: Path) -> dict[str, str]:
    """Return the photos of objects as data addresses, as many as fit."""
    found: dict[str, str] = {}
    size = 0
    for path in sorted(folder.glob(f"{PHOTOS}/*.jpg")):
        if resolved(folder, f"{PHOTOS}/{path.name}") is None:
            continue
        content = path.read_bytes()
        size += len(content)
        if size > _MOST_PHOTOS:
            break
        found[path.stem] = f"data:image/jpeg;base64,{base64.b64encode(content).decode()}"
    return found


def _page(facts: bytes, points: bytes, *, title: str) -> str:
    """Return the page with its script, its style and its data; a policy allows these alone, by their digests."""
    script = (STATIC / "page.js").read_text(encoding="utf-8").replace("</script", "<\\/script")
    style = (STATIC / "page.css").read_text(encoding="utf-8")
    rules = f"default-src 'none'; script-src {_digest(script)}; style-src {_digest(style)}; img-src data: blob:"
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{rules}">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{html.escape(title)}</title>\n<style>{style}</style>\n</head>\n<body>\n"
        f'<div id="app"></div>\n{_data("embedded-survey", facts)}{_data("embedded-points", points)}'
        f'<script type="module">{script}</script>\n</body>\n</html>\n'
    )


def _digest(text: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"


def _data(name: str, content: bytes) -> str:
    packed = base64.b64encode(gzip.compress(content, 6, mtime=0)).decode()
    return f'<script type="text/plain" id="{name}">{packed}</script>\n'

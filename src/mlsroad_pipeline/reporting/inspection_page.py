"""Report on the files of a survey as an HTML page, with maps of density and height."""

from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.codings import CODE_NAMES
from mlsroad_pipeline.algorithms.quality.inspection import SurveyMap
from mlsroad_pipeline.reporting.figures import empty_figure, tidy_axes
from mlsroad_pipeline.reporting.html.report import (
    build_report,
    facts_section,
    figures_section,
    table_section,
    warnings_section,
)

EMPTY = "#10141a"


def survey_map_figure(survey: SurveyMap, *, title: str = "") -> Figure:
    """Draw the point density and the maximum height of a survey."""
    rows, columns = survey.shape
    side_by_side = rows >= columns / 3
    figure = empty_figure(11.0, 5.2 if side_by_side else 6.5)
    axes = figure.subplots(*((1, 2) if side_by_side else (2, 1)))
    density = survey.density()
    top = np.where(survey.counts > 0, survey.top, np.nan)
    extent = (0.0, columns * survey.cell, 0.0, rows * survey.cell)
    full = np.isfinite(density)
    dense = LogNorm(*np.quantile(density[full], [0.01, 0.999]) * [1, 1.0001]) if full.any() else None
    heights = np.quantile(top[full], [0.01, 0.99]) if full.any() else (0.0, 1.0)
    drawn: tuple[tuple[NDArray, str, str, dict[str, Any]], ...] = (
        (density, "points per m²", "inferno", {"norm": dense}),
        (top, "maximum height, m", "viridis", {"vmin": heights[0], "vmax": heights[1]}),
    )
    for axis, (values, label, colours, scale) in zip(axes, drawn, strict=True):
        axis.set_facecolor(EMPTY)
        image = axis.imshow(
            values, origin="lower", extent=extent, cmap=mpl.colormaps[colours], interpolation="nearest", **scale
        )
        bar = figure.colorbar(image, ax=axis, shrink=0.75, pad=0.02)
        bar.set_label(label, fontsize=8)
        bar.ax.tick_params(labelsize=7)
        tidy_axes(axis)
        axis.set_xlabel("east, m", fontsize=8)
        axis.set_ylabel("north, m", fontsize=8)
        axis.tick_params(labelsize=7)
    if title:
        figure.suptitle(title, fontsize=10)
    return figure


MOST_PICTURES = 12
"""Maximum number of maps in the report."""


def survey_page(
    survey: str, facts: Sequence[Mapping[str, Any]], maps: Mapping[str, SurveyMap], warnings: pd.DataFrame
) -> str:
    """Return the report as an HTML page, from the facts of each file and the maps by file."""
    systems = sorted({fact["crs_name"] or "none" for fact in facts})
    summary = {
        "files": len(facts),
        "points": sum(fact["n_points"] for fact in facts),
        "size, MB": sum(fact["bytes"] for fact in facts) / 1e6,
        "formats": ", ".join(sorted({_kind(fact) for fact in facts})) or "none",
        "coordinate reference system": ", ".join(systems) or "none",
    }
    messages = [f"{row.file}: {row.warning}" for row in warnings.itertuples()]
    drawable = [name for name in maps if maps[name].drawable]
    pictures = {name: survey_map_figure(maps[name]) for name in drawable[:MOST_PICTURES]}
    some = f": the first {MOST_PICTURES} of {len(drawable)} files" if len(drawable) > MOST_PICTURES else ""
    if len(drawable) < len(maps):
        some += f"; not drawn: {', '.join(name for name in maps if name not in drawable)}, with points too far away"
    sections = [
        facts_section("Survey", summary),
        warnings_section("Warnings", messages),
        table_section("Files", pd.DataFrame([_file_row(fact) for fact in facts])),
        figures_section(f"From above{some}", pictures),
        table_section("Columns", pd.DataFrame([row for fact in facts for row in _column_rows(fact)])),
        table_section(
            "Times and scan lines",
            pd.DataFrame([{"file": fact["file"], **fact["time"], **fact["scan_lines"]} for fact in facts]),
        ),
        table_section("Codes", pd.DataFrame([row for fact in facts for row in _code_rows(fact)])),
    ]
    return build_report(sections, title="Survey inspection", subtitle=survey)


def _kind(fact: Mapping[str, Any]) -> str:
    details = fact["details"]
    if fact["format"] != "LAS":
        return str(fact["format"])
    return f"{'LAZ' if details['compressed'] else 'LAS'} {details['version']}, point format {details['point_format']}"


def _file_row(fact: Mapping[str, Any]) -> dict[str, Any]:
    row = {"file": fact["file"], "format": _kind(fact), "points": fact["n_points"], "points per m²": fact["density"]}
    for i, axis in enumerate("xyz"):
        row[f"{axis} from"], row[f"{axis} to"] = fact["low"][i], fact["high"][i]
    row["duplicates"] = f"{'' if fact['duplicates_exact'] else 'about '}{fact['n_duplicates']}"
    return row


def _column_rows(fact: Mapping[str, Any]) -> list[dict[str, Any]]:
    return [
        {"file": fact["file"], "column": name, **{key: value for key, value in column.items() if key != "counts"}}
        for name, column in fact["columns"].items()
    ]


def _code_rows(fact: Mapping[str, Any]) -> list[dict[str, Any]]:
    return [
        {
            **{"file": fact["file"], "column": name, "code": int(code)},
            "meaning": CODE_NAMES.get(int(code), "") if name == "classification" else "",
            **{"points": count, "share, %": 100.0 * count / max(fact["n_points"], 1)},
        }
        for name, column in fact["columns"].items()
        for code, count in column.get("counts", {}).items()
    ]

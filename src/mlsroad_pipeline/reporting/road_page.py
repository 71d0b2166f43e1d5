"""Page with the measures of a road: a strip along the path, sections, narrow and low places."""

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from mlsroad_pipeline.algorithms.inventory.objects.rules import KINDS
from mlsroad_pipeline.algorithms.inventory.road.sight import SIGHT_FIELDS
from mlsroad_pipeline.algorithms.inventory.road.table import INTRUDED, ROAD_FIELDS
from mlsroad_pipeline.reporting.figures import GRID, SERIES, empty_figure, tidy_axes
from mlsroad_pipeline.reporting.html.report import build_report, facts_section, figures_section, table_section

STRIP_NOTE = (
    "By station along the path, metres. Gaps: not seen. Width: dark between kerbs, light where a kerb is bridged or "
    "paved ground ends. Crossfall is positive where the lane falls to the right."
)
_LOWEST = 20  # places of the table of low places
_LOW = ("station", "clearance", "clearance_offset", "clearance_class", "clearance_object")
_INSIDE = ("station", "intrusion", "intrusion_offset", "intrusion_class", "intrusion_object")


def strip_figure(table: pd.DataFrame, sections: pd.DataFrame) -> Figure:
    """Draw width, crossfall and slope, clearance and the objects of each section along the path."""
    figure = empty_figure(11.0, 7.5)
    axes = figure.subplots(4, 1, sharex=True)
    station = table["station"]
    certain = (table["left_edge"] == "kerb") & (table["right_edge"] == "kerb")
    axes[0].plot(station, table["width"], color=SERIES[4], lw=1.4)
    axes[0].plot(station, table["width"].where(certain), color=SERIES[0], lw=1.6)
    axes[1].plot(station, table["crossfall"], color=SERIES[0], lw=1.4, label="crossfall")
    axes[1].plot(station, table["slope"], color=SERIES[1], lw=1.4, label="slope")
    axes[1].legend(frameon=False, fontsize=8, loc="upper right")
    axes[2].plot(station, table["clearance"], ".", color=SERIES[5], ms=3)
    axes[2].axhline(4.5, color=GRID, lw=1.2)
    _objects(axes[3], sections)
    labels = ("Width [m]", "[%]", "Clearance [m]", "Objects per 100 m")
    for part, label in zip(axes, labels, strict=True):
        part.set_ylabel(label, fontsize=9)
        part.grid(color=GRID, lw=0.6)
        tidy_axes(part)
    for part in (axes[0], axes[2], axes[3]):
        part.set_ylim(0.0, 1.08 * part.get_ylim()[1])  # nearly equal widths would lie on the frame
    axes[3].set_xlabel("Station [m]")
    return figure


def _objects(axes: Axes, sections: pd.DataFrame) -> None:
    """Draw stacked bars of the objects of each section, per 100 m."""
    start, end = sections["from_station"].to_numpy(), sections["to_station"].to_numpy()
    length, bottom = np.maximum(end - start, 1.0), np.zeros(len(sections))
    for number, kind in enumerate(kind for kind in KINDS if kind in sections):
        count = sections[kind].to_numpy(dtype=np.float64) * 100.0 / length
        axes.bar(start, count, end - start, bottom=bottom, align="edge", color=SERIES[number], label=kind, lw=0)
        bottom = bottom + count
    axes.set_ylim(top=max(1.0, 1.3 * bottom.max()))
    axes.legend(frameon=False, fontsize=8, loc="upper right", ncols=4)


def road_page(
    table: pd.DataFrame, sections: pd.DataFrame, sight: pd.DataFrame, survey: str, envelope: str | None
) -> str:
    """Return the page of a road."""
    facts = {"survey": survey, "length in metres": len(table), "envelope": envelope or "none"}
    low = table[table["clearance"].notna()].nsmallest(_LOWEST, "clearance", keep="first")
    inside = table[table["envelope"] == INTRUDED]
    headings = {name: field.alias for name, field in ROAD_FIELDS.items()}
    parts = [
        facts_section("Road", facts),
        figures_section("Along the path", {STRIP_NOTE: strip_figure(table, sections)}),
        table_section("Sections", sections),
        table_section(f"Lowest {_LOWEST} places above the carriageway", low[list(_LOW)].rename(columns=headings)),
    ]
    if len(sight):
        names = {name: field.alias for name, field in SIGHT_FIELDS.items()}
        parts.append(table_section("Sight to signs", sight.sort_values("sight").rename(columns=names)))
    if envelope is not None:
        parts.append(table_section("Inside the envelope", inside[list(_INSIDE)].rename(columns=headings)))
    return build_report(parts, title="Road", subtitle=survey)

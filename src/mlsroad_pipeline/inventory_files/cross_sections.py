"""Sections across a road as CSV, SVG and DXF: points by class, the surface of the carriageway, its measures."""

import io
from dataclasses import dataclass
from html import escape
from pathlib import Path

import numpy as np
import pandas as pd
from ezdxf import units
from ezdxf.filemanagement import new
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.palette import class_palette, rgb_to_hex
from mlsroad_pipeline.formats.files import write_atomic
from mlsroad_pipeline.inventory_files.drawing import VERSION, layer_name, without_dates
from mlsroad_pipeline.inventory_files.vector_files import without_formulas

_THINNED = 0.05  # edge of the squares that keep one point of each class in drawings, metres
_PIXELS = 40  # per metre
_BELOW, _ABOVE = 2.0, 12.0  # what an image shows below and above the road, metres
_REACH = 20.0  # and on both sides of the path
_SURFACE = "carriageway"
_NO_CLASS = "no_class"


@dataclass(frozen=True)
class CrossSection:
    """Section across a road at a station."""

    station: float
    points: pd.DataFrame  # x, y, z (world), station, offset, object_id, class
    profile: NDArray[np.float64]  # Offset and height of the surface between the edges
    measures: pd.Series  # Row of the road's table

    @property
    def name(self) -> str:
        """Name of the files."""
        return f"section_{self.station:09.2f}"

    def thinned(self) -> dict[str, NDArray[np.float64]]:
        """Return offsets and heights by class, one point of each small square."""
        places = self.points[["offset", "z"]].to_numpy()
        keys = pd.DataFrame(np.floor(places / _THINNED).astype(np.int64)).assign(name=self.points["class"])
        kept = ~keys.duplicated().to_numpy()
        names = self.points["class"].where(self.points["class"] != "", _NO_CLASS)
        return {str(name): places[rows] for name, rows in names[kept].groupby(names[kept]).groups.items()}

    def texts(self) -> list[str]:
        """Return the station and its measures as lines of text."""
        row = self.measures
        lines = [f"Station {self.station:.2f} m"]
        for name, unit in (("width", "m"), ("crossfall", "%"), ("slope", "%"), ("clearance", "m")):
            if np.isfinite(row[name]):
                what = f" ({row['clearance_class']})" if name == "clearance" and row["clearance_class"] else ""
                lines.append(f"{name} {row[name]:.2f} {unit}{what}")
        return lines


def write_cross_section(section: CrossSection, folder: Path) -> list[Path]:
    """Write a section as CSV with all points, and as SVG and DXF; return the paths."""
    table = without_formulas(section.points.round({"x": 3, "y": 3, "z": 3, "station": 3, "offset": 3}))
    texts = {
        "csv": table.to_csv(index=False, lineterminator="\n").encode(),
        "svg": _svg(section).encode(),
        "dxf": _dxf(section),
    }
    paths = [folder / f"{section.name}.{suffix}" for suffix in texts]
    for path, content in zip(paths, texts.values(), strict=True):
        write_atomic(path, content)
    return paths


def _dxf(section: CrossSection) -> bytes:
    """Return the drawing: x is the offset, y the height, both in metres; a layer per class."""
    text = io.StringIO()
    with without_dates():
        doc = new(VERSION, units=units.M)
        space = doc.modelspace()
        thinned = section.thinned()
        for (name, places), colour in zip(thinned.items(), class_palette(tuple(thinned)), strict=False):
            layer = layer_name("points", name)
            red, green, blue = colour.tolist()
            doc.layers.add(layer).rgb = (red, green, blue)
            for offset, z in places.tolist():
                space.add_point((offset, z), dxfattribs={"layer": layer})
        doc.layers.add(_SURFACE)
        doc.layers.add("text")
        if len(section.profile) > 1:
            space.add_lwpolyline(section.profile.tolist(), format="xy", dxfattribs={"layer": _SURFACE})
        bottom = _road_height(section) - _BELOW
        for number, line in enumerate(section.texts()):
            place = {"layer": "text", "height": 0.25, "insert": (-_REACH, bottom - 0.4 * number)}
            space.add_text(line, dxfattribs=place)
        doc.write(text)
        return bytes(doc.encode(text.getvalue()))


def _svg(section: CrossSection) -> str:
    top = _road_height(section) + _ABOVE
    width, height = round(2 * _REACH * _PIXELS), round((_ABOVE + _BELOW) * _PIXELS)

    def pixels(places: NDArray[np.float64]) -> list[tuple[float, float]]:
        moved = (places - [-_REACH, top]) * [_PIXELS, -_PIXELS]
        inside = (moved[:, 1] >= 0) & (moved[:, 1] <= height)
        return [(float(x), float(y)) for x, y in moved[inside].round(1)]

    thinned = section.thinned()
    drawn = []
    for (name, places), colour in zip(thinned.items(), class_palette(tuple(thinned)), strict=False):
        dots = "".join(f"M{x:g} {y:g}h0" for x, y in pixels(places))
        drawn.append(f'<path stroke="{rgb_to_hex(colour)}" d="{dots}"><title>{escape(name)}</title></path>')
    line = " ".join(f"{x:g},{y:g}" for x, y in pixels(section.profile))
    texts = "".join(
        f'<text x="10" y="{22 + 20 * number}">{escape(text)}</text>' for number, text in enumerate(section.texts())
    )
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" font-family="sans-serif" '
        f'font-size="16">\n<rect width="{width}" height="{height}" fill="white"/>\n'
        f'<g fill="none" stroke-width="2" stroke-linecap="round">\n{chr(10).join(drawn)}\n</g>\n'
        f'<polyline points="{line}" fill="none" stroke="black" stroke-width="1.5"/>\n{texts}\n</svg>\n'
    )


def _road_height(section: CrossSection) -> float:
    """Return the height of the road on the path, else of the lowest point."""
    height = float(section.measures["z"])
    lowest = section.points["z"].min() if len(section.points) else 0.0
    return height if np.isfinite(height) else float(lowest)

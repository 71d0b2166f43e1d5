"""Table of all objects of an inventory: sorted, filtered and linked with the map by a script of the page."""

from __future__ import annotations

import re
from dataclasses import dataclass
from html import escape

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mlsroad_pipeline.reporting.html.object_map import object_data
from mlsroad_pipeline.reporting.html.object_script import SCRIPT
from mlsroad_pipeline.reporting.html.parts import cell, table_html

FIRST_ROWS = 40
"""Rows that a page shows without a script."""


@dataclass(frozen=True)
class ObjectTableSection:
    """Counts by kind, and all objects with their columns."""

    title: str  # The heading
    objects: pd.DataFrame  # Objects as `shown_objects` returns them
    total: pd.DataFrame  # Number of objects by kind and class
    names: dict[str, str]  # Column to heading, in order
    places: NDArray[np.float64]  # Positions on the map
    geopackage: str = ""  # Path or URL of the GeoPackage, relative to the report

    def body(self) -> str:
        """Return counts, the link, filters and the table."""
        path = escape(self.geopackage, quote=True)
        # URLs such as "javascript:..." must not become links
        safe = not re.match(r"^[A-Za-z][A-Za-z0-9+.\-]*:", self.geopackage) or self.geopackage.startswith("https://")
        target = f'<a href="{path}">{path}</a>' if safe else path
        link = f"<p>All objects as map layers: {target}</p>" if self.geopackage else ""
        script = f"{object_data(self.objects, self.names, self.places)}<script>{SCRIPT}</script>"
        if self.objects.empty:
            return f'{link}<p class="none">No objects were found.</p>{script}'
        every = int(self.total["objects"].sum())
        more = (
            f" The map and the table have {len(self.objects)} of {every} objects." if len(self.objects) < every else ""
        )
        return (
            f"{table_html(self.total)}{link}"
            "<p>Sorted by kind and score; a heading sorts by its column, a number shows the object on the map."
            f"{more}</p>"
            f"{self._filters()}{self._table()}{script}"
        )

    def _filters(self) -> str:
        kinds = "".join(
            f'<option value="{escape(k, quote=True)}">{escape(k)}</option>' for k in sorted(set(self.objects["kind"]))
        )
        return (
            '<form class="filters" id="object-filters" onsubmit="return false">'
            f'<label>Kind <select name="kind"><option value="">all</option>{kinds}</select></label>'
            '<label>Class or number <input name="text" type="search" size="14"></label>'
            '<label>Score from <input name="low" type="number" min="0" max="1" step="0.05" value="0"></label>'
            '<label>to <input name="high" type="number" min="0" max="1" step="0.05" value="1"></label>'
            '<output id="object-count" aria-live="polite"></output></form>'
        )

    def _table(self) -> str:
        columns = [name for name in self.names if name in self.objects]
        heads = "".join(
            f'<th scope="col" aria-sort="none"><button type="button" data-column="{n}">'
            f"{escape(self.names[name])}</button></th>"
            for n, name in enumerate(columns)
        )
        rows = "".join(
            "<tr>" + "".join(f"<td>{cell(value)}</td>" for value in row) + "</tr>"
            for row in self.objects[columns].head(FIRST_ROWS).to_numpy(dtype=object).tolist()
        )
        return (
            '<div class="scroll objects" tabindex="0" role="region" aria-label="Table of objects"><table id="objects">'
            f"<thead><tr>{heads}</tr></thead><tbody>{rows}</tbody></table></div>"
            '<p class="paper">Printed with the first sixteen columns; the files have all.</p>'
            '<p><button type="button" id="object-more" hidden>Show more</button></p>'
        )

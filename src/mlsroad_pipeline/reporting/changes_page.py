"""Page of a comparison: map and table of the states, pairs of pictures, surfaces."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mlsroad_pipeline.reporting.clouds.pictures import MapFrame
from mlsroad_pipeline.reporting.html.objects import MOST_OBJECTS, object_map_section, object_table_section
from mlsroad_pipeline.reporting.html.report import (
    Picture,
    Section,
    build_report,
    facts_section,
    gallery_section,
    warnings_section,
)

PAIR_NOTE = "Left the earlier survey, right the later one; from above, north up, and from the south."


class ChangesMap(NamedTuple):
    """Frame of the map, its background, and the path of the scanner."""

    frame: MapFrame
    background: NDArray[np.uint8] | None
    path: NDArray[np.float64] | None


def changes_page(
    table: pd.DataFrame,
    names: Mapping[str, str],
    drawn: ChangesMap,
    *,
    title: str,
    subtitle: str,
    facts: Mapping[str, Any],
    layers: str,
    pictures: Mapping[str, Sequence[Picture]] | None = None,
    further: Sequence[Section] = (),
    warnings: Sequence[str] = (),
) -> str:
    """Return the page.

    `table` has `kind` (of the object), `state`, `x`, `y` and the columns of `names`, which are their headings; `layers`
    is the GeoPackage beside the page. The states of most rows come last, and are left out where there are too many.
    """
    counts = table["state"].value_counts()
    order = table.assign(rank=table["state"].map(counts)).sort_values(["rank", "state"], kind="stable").index
    listed = table.loc[order].reset_index(drop=True)
    shown = listed.assign(object_id=np.arange(1, len(listed) + 1), kind=listed["state"])
    shown["class"] = listed["kind"]
    shown = shown.head(MOST_OBJECTS)
    headings = {"object_id": "Row", "kind": "State", "class": "Kind", **names}
    total = pd.crosstab(table["kind"], table["state"]).reset_index().rename_axis(columns=None)
    total["objects"] = total.drop(columns="kind").sum(axis=1)
    places = drawn.frame.place(shown[["x", "y"]].to_numpy(dtype=np.float64))
    by_state = {str(state): int(n) for state, n in counts.sort_index().items()}
    sections = [
        facts_section("Comparison", facts),
        object_map_section("Map", shown, drawn.frame, by_state, drawn.path, drawn.background),
        *([] if pictures is None else [gallery_section("Changes", pictures, PAIR_NOTE)]),
        *further,
        object_table_section("Objects", shown, total, headings, places, geopackage=layers),
        warnings_section("Warnings", list(warnings)),
    ]
    return build_report(sections, title=title, subtitle=subtitle)

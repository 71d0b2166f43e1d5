"""Order of review of the objects of an inventory, as the page and the commands use it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.inventory.objects.review import order_of_review
from mlsroad_pipeline.review.corrections.states import ObjectState

_NEEDED = ("object_id", "kind", "score", "point_count")


def review_order(
    inventory_rows: Sequence[Mapping[str, Any]] | pd.DataFrame, states: Mapping[int, ObjectState], number: int
) -> list[dict[str, Any]]:
    """Return the objects to look at first."""
    table = inventory_rows if isinstance(inventory_rows, pd.DataFrame) else pd.DataFrame(list(inventory_rows))
    if table.empty:
        return []
    missing = [name for name in _NEEDED if name not in table]
    if missing:
        raise DataError(f"order of review: the inventory has no column {missing[0]!r}")
    table = table.reset_index(drop=True)
    known = {"accepted": 1.0, "moved": 1.0, "split": 1.0, "merged": 1.0, "changed": 1.0, "rejected": 0.0, "": np.nan}
    decided = np.array([known[states.get(int(n), {}).get("status", "")] for n in table["object_id"]], dtype=np.float64)
    order = order_of_review(table, decided, number)
    columns = ("object_id", "kind", "score")
    picked = table.loc[order.rows, list(columns)].to_dict("records")
    return [
        {**{str(name): value for name, value in row.items()}, "reason": reason, "expected_precision": float(precision)}
        for row, reason, precision in zip(picked, order.reasons, order.precision, strict=True)
    ]

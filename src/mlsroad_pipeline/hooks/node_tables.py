"""Tables with one row per node, updated by runs of single pipelines."""

from __future__ import annotations

import pandas as pd
from kedro.io import CatalogProtocol


def save_rows(catalog: CatalogProtocol, key: str, table: pd.DataFrame) -> None:
    """Save the rows of the nodes of this run; rows of other nodes are kept."""
    if catalog.exists(key):
        before = catalog.load(key)
        table = pd.concat([before[~before["node"].isin(table["node"])], table], ignore_index=True)
    catalog.save(key, table)

"""Tables with a row for each node, which runs of single pipelines bring up to date."""

from __future__ import annotations

import pandas as pd
from kedro.io import CatalogProtocol


def save_rows(catalog: CatalogProtocol, key: str, table: pd.DataFrame) -> None:
    """Save the rows of the nodes that ran; nodes that did not run keep theirs."""
    if catalog.exists(key):
        before = catalog.load(key)
        table = pd.concat([before[~before["node"].isin(table["node"])], table], ignore_index=True)
    catalog.save(key, table)

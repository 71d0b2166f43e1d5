"""Copies of the inventory in the formats of `label.export`."""

from __future__ import annotations

from collections.abc import Sequence

from mlsroad_pipeline.execution.run_folder import RunFolder
from mlsroad_pipeline.inventory_files.exports import EXPORTS
from mlsroad_pipeline.inventory_files.road_inventory import RoadInventory


def export_inventory(inventory: RoadInventory, formats: Sequence[str], run: RunFolder) -> list[str]:
    """Write an inventory in several formats, move the files to their places and return their paths."""
    folder = run.staged(run.output / "inventory").parent
    folder.mkdir(parents=True, exist_ok=True)
    written: list[str] = []
    for name in formats:
        written += [str(run.publish(path)) for path in EXPORTS[name].write(inventory, folder)]
    return list(dict.fromkeys(written))

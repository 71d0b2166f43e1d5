"""A planted measured road beside the path of `helpers.page_output`."""

import numpy as np
import pandas as pd

from mlsroad_pipeline.algorithms.inventory.road.places import road_places
from mlsroad_pipeline.algorithms.inventory.road.sight import SIGHT_FIELDS
from mlsroad_pipeline.algorithms.inventory.road.stations import RoadPath
from mlsroad_pipeline.algorithms.inventory.road.table import ROAD_FIELDS, section_medians
from mlsroad_pipeline.inventory_files.road_files import write_road

STATIONS = 25


def planted_road():
    """Return table and path of a road eastwards: intrusions of a tree and a sign, and a low branch."""
    n = STATIONS
    xyz = np.column_stack([500.0 + np.arange(n + 1), np.full(n + 1, 897.0), np.full(n + 1, 14.0)])
    path = RoadPath(xyz, np.arange(n + 1, dtype=np.float64))
    blank = {"str": "", "int64": 0, "float64": np.nan}
    table = pd.DataFrame({name: [blank[field.dtype]] * n for name, field in ROAD_FIELDS.items()})
    table["station"], table["x"], table["y"], table["z"] = np.arange(n) + 0.5, path.middles[:, 0], 897.0, 12.0
    seen = slice(0, 19)
    table.loc[seen, ["width", "crossfall", "left_offset", "right_offset"]] = [6.5, 2.5, -4.0, 2.5]
    table.loc[seen, "left_edge"] = table.loc[seen, "right_edge"] = "kerb"
    table.loc[seen, "envelope"] = "free"
    for name in ("clearance", "intrusion"):
        columns = [name, f"{name}_offset", f"{name}_class", f"{name}_object"]
        for row, height in ((5, 3.6), (6, 3.1), (7, 3.3)):
            table.loc[row, columns] = [height, 1.0, "tree", 4]
        table.loc[12, columns] = [3.4, -0.5, "sign", 0]
    table.loc[15, ["clearance", "clearance_offset", "clearance_class"]] = [3.8, -2.5, "tree"]
    table.loc[[5, 6, 7, 12], "envelope"] = "intruded"
    return table.astype({name: field.dtype for name, field in ROAD_FIELDS.items()}), path


def write_planted_road(folder, *, inventory, crs=None):
    """Write the measures of the planted road into a folder of results; `inventory` is the digest of its inventory."""
    table, path = planted_road()
    sections = section_medians(table, pd.DataFrame({"section": ["1"], "from_station": [0.0], "to_station": [25.0]}))
    sight = pd.DataFrame({name: [] for name in SIGHT_FIELDS}).astype({n: f.dtype for n, f in SIGHT_FIELDS.items()})
    places = road_places(table, path, least_clearance=4.0).assign(checked="")
    (folder / "road").mkdir(exist_ok=True)
    facts = {"inventory": inventory}
    return write_road(table, sections, sight, places, folder / "road", path=path, crs=crs, facts=facts)

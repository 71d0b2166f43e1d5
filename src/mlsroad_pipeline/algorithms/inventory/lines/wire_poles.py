"""Poles that carry overhead wires."""

import numpy as np
import pandas as pd
import shapely

_REACH, _GAP = 0.5, 8.0  # largest distance from the line of a wire in plan, and beyond its visible end, metres
_LEAST_HEIGHT = 4.0  # of a pole, metres
_HEIGHTS = (0.6, 1.12)  # range of the height of the wire at the pole, as shares of the pole's


def with_utility_poles(objects: pd.DataFrame, lines: pd.DataFrame) -> pd.DataFrame:
    """Return objects with the type `utility` of the poles that wires run to, extended straight beyond their ends."""
    wires = shapely.from_wkt(lines.loc[lines["kind"] == "wire", "line"].to_numpy(dtype=object))
    rows = np.flatnonzero((objects["kind"] == "pole") & (objects["height"] > _LEAST_HEIGHT))
    if not len(wires) or not len(rows):
        return objects
    poles = objects.iloc[rows]
    turn, lean = np.radians(poles["lean_azimuth"].fillna(0.0)), np.tan(np.radians(poles["tilt"].fillna(0.0)))
    shift = (lean * poles["height"]).to_numpy()[:, None] * np.column_stack([np.sin(turn), np.cos(turn)])
    top, base, height = poles[["x", "y"]].to_numpy() + shift, poles["z"].to_numpy(), poles["height"].to_numpy()
    carries = np.zeros(len(rows), bool)
    for wire in wires:
        vertices = shapely.get_coordinates(wire, include_z=True)
        way = vertices[-1, :2] - vertices[0, :2]
        length = float(np.hypot(*way))
        if length > 0:
            off = top - vertices[0, :2]
            along, aside = off @ way / length, np.abs(off @ [way[1], -way[0]]) / length
            share = (
                np.interp(along, (vertices[:, :2] - vertices[0, :2]) @ way / length, vertices[:, 2]) - base
            ) / height
            beside = (aside < _REACH) & (along >= -_GAP) & (along <= length + _GAP)
            carries |= beside & (share > _HEIGHTS[0]) & (share < _HEIGHTS[1])
    kinds = objects["pole_type"].to_numpy(dtype=object, copy=True)
    kinds[rows[carries]] = "utility"
    return objects.assign(pole_type=kinds).astype({"pole_type": "str"})

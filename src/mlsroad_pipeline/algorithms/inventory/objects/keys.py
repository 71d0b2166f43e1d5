"""Keys of objects that last: another run, model or survey of the same street keeps them."""

from collections.abc import Set
from uuid import UUID, uuid5

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.geometry.assignment import assign_one_to_one
from mlsroad_pipeline.algorithms.inventory.objects.rules import KINDS

REACH = {"pole": 1.0, "sign": 1.0, "tree": 2.0, "vehicle": 1.5}
"""Kind to the largest distance in plan of the places of one object in two inventories, metres."""

_OTHER_KIND = 0.5  # an object whose kind is another now, metres
_SPACE = UUID("5f0a1d5e-7c0b-4f0e-9a55-3d1c6c0f4a21")


def lasting_keys(objects: pd.DataFrame, *earlier: pd.DataFrame, crs: str | None = None) -> NDArray[np.object_]:
    """Return the key of each object: that of the first earlier inventory with the same object, else a new one.

    Objects are the same if they are of one kind and at most `REACH` apart, one to one. What is left is matched
    regardless of its kind within 0.5 m, vehicles excepted: a user may have changed a tree to a pole. A new key follows
    from kind, place and reference system alone, so two runs with the same objects give the same keys.
    """
    keys = np.full(len(objects), "", dtype=np.object_)
    groups = [((kind,), reach) for kind, reach in REACH.items()]
    for table in earlier:
        known = table[(table["key"] != "") & ~table["key"].isin(keys)].drop_duplicates("key")
        free = np.ones(len(known), dtype=np.bool_)
        for kinds, reach in [*groups, (tuple(kind for kind in KINDS if kind != "vehicle"), _OTHER_KIND)]:
            here = np.flatnonzero(objects["kind"].isin(kinds).to_numpy() & (keys == ""))
            there = np.flatnonzero(known["kind"].isin(kinds).to_numpy() & free)
            mine, other = assign_one_to_one(_places(objects, here), _places(known, there), reach)
            keys[here[mine]] = known["key"].to_numpy(dtype=np.object_)[there[other]]
            free[there[other]] = False
    taken = {key for table in earlier for key in table["key"]}
    return new_keys(objects.assign(key=keys), taken=taken, crs=crs)


def new_keys(objects: pd.DataFrame, *, taken: Set[str] = frozenset(), crs: str | None = None) -> NDArray[np.object_]:
    """Return the column `key` of a table of objects, with new keys, none of them in `taken`, where it is empty."""
    keys = objects["key"].to_numpy(dtype=np.object_, copy=True)
    others = {*taken, *keys}
    for row in np.flatnonzero(keys == ""):
        place = objects.iloc[row]
        keys[row] = _new_key(f"{crs or ''} {place['kind']} {place['x']:.2f} {place['y']:.2f}", others)
        others.add(keys[row])
    return keys


def _places(table: pd.DataFrame, rows: NDArray[np.int64]) -> NDArray[np.float64]:
    return table[["x", "y"]].to_numpy(dtype=np.float64)[rows]


def _new_key(text: str, taken: Set[str]) -> str:
    """Return the key of a text that nothing has yet."""
    key, number = str(uuid5(_SPACE, text)), 1
    while key in taken:
        number += 1
        key = str(uuid5(_SPACE, f"{text} {number}"))
    return key

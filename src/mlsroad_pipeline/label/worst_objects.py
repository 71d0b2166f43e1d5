"""Pictures of the worst objects of a scored inventory, cut out of the labelled clouds."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.palette import las_palette
from mlsroad_pipeline.algorithms.inventory.scoring.object_scores import FALSE, MISSED, RIGHT
from mlsroad_pipeline.formats.base import ReadOptions
from mlsroad_pipeline.formats.registry import get_format
from mlsroad_pipeline.label.object_scoring import ScoredInventory
from mlsroad_pipeline.reporting.clouds.pictures import object_picture
from mlsroad_pipeline.reporting.html.report import Picture

CHUNK = 2_000_000
"""Points that are read at once."""
MOST_POINTS = 60_000
"""Largest number of points of a part; of more, evenly spaced ones are kept."""
CLASS = "classification"


class CutOut(NamedTuple):
    """Points around a place: coordinates relative to it (z as in the survey), and class codes."""

    xyz: NDArray[np.float32]
    code: NDArray[np.uint8]


def cut_out(clouds: Sequence[Path], places: NDArray[np.float64], reach: NDArray[np.float64]) -> list[CutOut]:
    """Return the points within `reach` in x and y of each place; clouds are read once, in parts."""
    parts: list[list[CutOut]] = [[] for _ in places]
    for path in clouds:
        form = get_format(path)
        info = form.info(path, ReadOptions())
        only = tuple(name for name in (CLASS,) if name in info.columns)
        for start in range(0, info.n_points, CHUNK):
            cloud = form.read(path, ReadOptions(only=only), start=start, stop=start + CHUNK)
            code = cloud[CLASS].astype(np.uint8) if only else np.zeros(len(cloud), np.uint8)
            for part, place, half in zip(parts, places, reach, strict=True):
                shift = np.array([*place, 0.0]) - cloud.origin
                near = np.flatnonzero(np.abs(cloud.xyz[:, :2] - shift[:2]).max(axis=1) <= half)
                part.append(CutOut((cloud.xyz[near] - shift).astype(np.float32), code[near]))
    return [_joined(part) for part in parts]


def _joined(part: Sequence[CutOut]) -> CutOut:
    if not part:
        return CutOut(np.empty((0, 3), np.float32), np.empty(0, np.uint8))
    xyz, code = np.concatenate([piece.xyz for piece in part]), np.concatenate([piece.code for piece in part])
    step = -(-len(xyz) // MOST_POINTS) or 1
    return CutOut(xyz[::step], code[::step])


class Case(NamedTuple):
    """Object to be shown: a text, its place, and whether it is listed or true."""

    text: str
    x: float
    y: float
    z: float
    size: float
    listed: bool
    true: tuple[float, float] | None = None


def worst_cases(scored: ScoredInventory, *, most: int = 6) -> dict[str, list[Case]]:
    """Return, by kind and outcome, the false objects with the highest scores, missed ones and the largest errors."""
    objects, truth = scored.matched.objects, scored.matched.truth
    cases: dict[str, list[Case]] = {}
    for kind in sorted(set(objects["kind"]) | set(truth["kind"])):
        mine, own = objects[objects["kind"] == kind], truth[truth["kind"] == kind]
        false = mine[mine["outcome"] == FALSE].sort_values("score", ascending=False, kind="stable").head(most)
        missed = own[own["outcome"] == MISSED]
        if "points" in missed:
            missed = missed.sort_values("points", ascending=False, kind="stable")
        far = mine[mine["outcome"] == RIGHT].sort_values("distance", ascending=False, kind="stable").head(most // 2)
        cases |= {
            f"{kind}: false, highest scores": [_listed_case(row) for row in false.to_dict("records")],
            f"{kind}: missed": [_missed_case(row) for row in missed.head(most).to_dict("records")],
            f"{kind}: right, largest errors of position": [
                _listed_case(row, truth.iloc[int(row["true_row"])]) for row in far.to_dict("records")
            ],
        }
    return {name: found for name, found in cases.items() if found}


def _listed_case(row: Mapping[str, Any], true: pd.Series | None = None) -> Case:
    other = f", is a {row['true_kind']}" if row["true_kind"] else ""
    error = "" if true is None else f", {row['distance']:.2f} m off"
    text = f"{row['object_id']} {row['class']}, score {row['score']:.2f}, {row['height']:.1f} m high{other}{error}"
    place = None if true is None else (float(true["x"]), float(true["y"]))
    return Case(text, row["x"], row["y"], row["z"], max(row["height"], 2.0), True, place)


def _missed_case(row: Mapping[str, Any]) -> Case:
    known = {name: row.get(name) for name in ("height", "points", "z")}
    high = "" if pd.isna(known["height"]) else f", {known['height']:.1f} m high"
    points = "" if pd.isna(known["points"]) else f", {int(known['points'])} points"
    number = row.get("name", row.get("id", ""))
    size = 3.0 if pd.isna(known["height"]) else max(float(known["height"]), 2.0)
    z = np.nan if known["z"] is None else float(known["z"])
    return Case(f"{number}{high}{points}".strip(", "), row["x"], row["y"], z, size, False, (row["x"], row["y"]))


def worst_pictures(scored: ScoredInventory) -> dict[str, list[Picture]]:
    """Return pictures of the worst objects by kind and outcome; none without labelled clouds."""
    groups = worst_cases(scored) if scored.clouds else {}
    pictures = iter(pictures_of([case for group in groups.values() for case in group], scored.clouds))
    return {name: [next(pictures) for _ in group] for name, group in groups.items()}


def pictures_of(cases: Sequence[Case], clouds: Sequence[Path]) -> list[Picture]:
    """Return a picture of each object, cut out of the labelled clouds."""
    reach = np.array([min(max(0.9 * case.size, 2.5), 9.0) for case in cases])
    places = np.array([(case.x, case.y) for case in cases]).reshape(-1, 2)
    parts = cut_out(clouds, places, reach)
    return [_picture(case, part, half) for case, part, half in zip(cases, parts, reach, strict=True)]


def _picture(case: Case, part: CutOut, reach: float) -> Picture:
    lowest = float(np.quantile(part.xyz[:, 2], 0.02)) if len(part.xyz) else 0.0
    true = None if case.true is None else (case.true[0] - case.x, case.true[1] - case.y)
    bottom = lowest if np.isnan(case.z) else case.z
    colours = las_palette()[part.code]
    return Picture(
        object_picture(part.xyz, colours, reach=reach, bottom=bottom, listed=case.listed, true=true), case.text
    )

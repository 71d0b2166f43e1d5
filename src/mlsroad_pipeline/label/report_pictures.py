"""Map and pictures of the report of `label`, from the thinned points of the scenes."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mlsroad_pipeline.execution.collection import SceneCollection
from mlsroad_pipeline.inventory_files.road_inventory import RoadInventory
from mlsroad_pipeline.label.picture_sample import PictureSample
from mlsroad_pipeline.reporting.clouds.object_pictures import object_picture
from mlsroad_pipeline.reporting.clouds.overview import MapFrame, map_frame, overview_picture, scene_pictures
from mlsroad_pipeline.reporting.html.gallery import Picture

FRAME_POINTS = 500
"""Points of each scene that the frame of the map is computed from."""


class ReportPictures(NamedTuple):
    """Frame of the map, its background, pictures of the scene with most objects, and pictures of single objects."""

    frame: MapFrame
    background: NDArray[np.uint8] | None
    scene: dict[str, NDArray[np.uint8]]
    objects: dict[str, list[Picture]]


def report_pictures(results: SceneCollection, inventory: RoadInventory, palette: NDArray[np.uint8]) -> ReportPictures:
    """Return the map and the pictures; scenes are read one at a time by each of three threads."""
    samples, objects = results.part("sample"), inventory.objects
    points = np.concatenate([_some(samples[key].load()) for key in samples])
    path = np.zeros((0, 2)) if inventory.trajectory is None else inventory.trajectory.xyz[:, :2]
    frame = map_frame(points, np.concatenate([objects[["x", "y"]].to_numpy(), path]))
    if not len(points):
        return ReportPictures(frame, None, {}, {})
    with ThreadPoolExecutor(2) as pool:
        scene = pool.submit(_busiest, samples, objects, palette)
        extremes = pool.submit(_extremes, samples, objects, palette)
        background = overview_picture(_cores(samples), palette, frame)
        return ReportPictures(frame, background, scene.result(), extremes.result())


def _some(sample: PictureSample) -> NDArray[np.float64]:
    rows = np.flatnonzero(sample["core"])
    rows = rows[:: max(1, len(rows) // FRAME_POINTS)]
    return sample["xyz"][rows, :2].astype(np.float64) + sample["origin"][:2]


def _cores(samples: SceneCollection) -> Iterator[tuple[NDArray[np.float64], NDArray[np.integer]]]:
    for handle in samples.values():
        sample = handle.load()
        yield sample["xyz"][sample["core"]].astype(np.float64) + sample["origin"], sample["label"][sample["core"]]


def _busiest(
    samples: SceneCollection, objects: pd.DataFrame, palette: NDArray[np.uint8]
) -> dict[str, NDArray[np.uint8]]:
    """Return pictures of the scene with most objects."""
    counts = objects["scene"].value_counts().reindex(list(samples), fill_value=0)
    key = str(counts.index[int(counts.to_numpy().argmax())])
    sample = samples[key].load()
    if len(sample["xyz"]) < 2:
        return {}
    above, side = scene_pictures(sample["xyz"].astype(np.float64), sample["label"], palette)
    which = "" if len(samples) == 1 else f"Part of the survey{' with most objects' if len(objects) else ''}, "
    captions = (f"{which}from above.", f"{which}from the side: what lies beyond its middle.")
    return {text[0].upper() + text[1:]: picture for text, picture in zip(captions, (above, side), strict=True)}


def _extremes(samples: SceneCollection, objects: pd.DataFrame, palette: NDArray[np.uint8]) -> dict[str, list[Picture]]:
    """Return a picture of the most and of the least certain object of each kind."""
    shown: dict[str, list[Picture]] = {}
    for kind, rows in objects[objects["scene"].isin(list(samples))].groupby("kind", sort=True):
        ordered = rows.sort_values(["score", "object_id"], ascending=[False, True], kind="stable")
        ends = (
            {"most certain": ordered.iloc[0], "least certain": ordered.iloc[-1]}
            if len(rows) > 1
            else {"only one": ordered.iloc[0]}
        )
        shown[str(kind)] = [
            Picture(_picture(row, samples[row["scene"]].load(), palette), _caption(text, row))
            for text, row in ends.items()
        ]
    return shown


def _caption(text: str, row: pd.Series) -> str:
    return f"{text}: {row['object_id']} {row['class']}, score {row['score']:.2f}, {row['height']:.1f} m high"


def _picture(row: pd.Series, sample: PictureSample, palette: NDArray[np.uint8]) -> NDArray[np.uint8]:
    reach = float(np.clip(0.7 * max(row["height"], row["width"]), 2.0, 9.0))
    place = np.array([row["x"], row["y"], 0.0]) - sample["origin"]
    near = np.abs(sample["xyz"][:, :2] - place[:2]).max(axis=1) <= reach
    xyz = (sample["xyz"][near].astype(np.float64) - place).astype(np.float32)
    return object_picture(xyz, palette[sample["label"][near]], reach=reach, bottom=float(row["z"]))

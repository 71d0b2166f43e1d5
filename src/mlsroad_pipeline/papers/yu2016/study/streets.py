"""Simulated streets of the study of Yu et al. 2016, and their reference objects."""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY
from mlsroad_pipeline.algorithms.core.stage_parameters import GroundParameters
from mlsroad_pipeline.algorithms.segmentation.euclidean import cluster
from mlsroad_pipeline.algorithms.stages import find_ground
from mlsroad_pipeline.papers.shared.studies.streets import cut_street, timed
from mlsroad_pipeline.simulation.parameters.presets import SimulationParameters
from mlsroad_pipeline.simulation.runtime.survey import simulate_survey

RUN_IN = 12.0
"""Road driven beyond both ends of a street, metres."""

IMAGE_GAP = 2.0
"""Smallest distance between two images of one moving object, metres."""

STREAK = 8.0
"""Greatest length of an image of a car in the reference, metres: 1.5 times the longest car."""

_CARS = [TAXONOMY[name] for name in ("car", "van")]
_MOVING = [
    TAXONOMY[name]
    for name in ("car", "van", "truck", "bus", "train", "other_vehicle", "motorcycle", "bicycle", "rider", "person")
]


def make_survey(*, simulation: SimulationParameters, ground: GroundParameters) -> dict[str, Any]:
    """Simulate a street as one scene; the facts have the CPU time of the ground filter and the number of streaks.

    The van drives `RUN_IN` farther at both ends. The scan planes are oblique, so that objects near the ends of a drive
    are scanned only in part; the scene does not own them.
    """
    columns = ("intensity", "gps_time", "scanner", "label", "instance")
    survey = simulate_survey(replace(simulation, length=simulation.length + 2 * RUN_IN), n_threads=1)
    street, station = cut_street(survey, ground=ground, columns=columns, source=f"street of seed {simulation.seed}")
    core = (station >= RUN_IN) & (station <= RUN_IN + simulation.length)
    images = separate_images(street.xyz, street["instance"], np.isin(street["label"], _MOVING))
    instance = without_streaks(street.xyz, images, np.isin(street["label"], _CARS))
    label = whole_gantries(street["label"], instance)
    cloud = replace(street, columns={**street.columns, "label": label, "instance": instance, "core": core})
    _, seconds = timed(find_ground, cloud, ground)
    streaks = len(np.unique(images[core & (images != instance)]))
    facts = {"seconds": seconds, "points": len(cloud), "streaks": streaks}
    return {"points": cloud, "facts": {name: np.array(value) for name, value in facts.items()}}


def separate_images(
    xyz: NDArray[np.floating], instance: NDArray[np.integer], rows: NDArray[np.bool_]
) -> NDArray[np.int32]:
    """Number the images of moving objects separately: each scanner records the whole object in another place.

    The two scanners pass a place about one second apart. In the point cloud, a moving car appears as two cars many
    metres apart, to annotators as to segmentations.
    """
    out = np.asarray(instance, dtype=np.int32).copy()
    last = int(out.max(initial=0))
    moving = np.flatnonzero(rows & (out > 0))
    if len(moving) == 0:
        return out
    moving = moving[np.argsort(out[moving], kind="stable")]
    names, first = np.unique(out[moving], return_index=True)
    flat = np.column_stack([xyz[moving, :2].astype(np.float64), np.zeros(len(moving))])
    for name, members in zip(names.tolist(), np.split(np.arange(len(moving)), first[1:]), strict=True):
        image = cluster(np.ascontiguousarray(flat[members]), tolerance=IMAGE_GAP)
        out[moving[members]] = np.where(image > 0, image + last, name)
        last += int(image.max())
    return out


def without_streaks(
    xyz: NDArray[np.floating], instance: NDArray[np.integer], rows: NDArray[np.bool_]
) -> NDArray[np.int32]:
    """Remove images of cars from the reference that are too long to be recognised.

    A car that moves with the van is scanned for as long as it stays next to it.
    """
    out = np.asarray(instance, dtype=np.int32).copy()
    cars = np.flatnonzero(rows & (out > 0))
    cars = cars[np.argsort(out[cars], kind="stable")]
    for members in np.split(cars, np.flatnonzero(np.diff(out[cars])) + 1):
        if len(members) < 2:
            continue
        flat = xyz[members, :2].astype(np.float64)
        axis = np.linalg.eigh(np.cov(flat.T))[1][:, -1]
        if np.ptp(flat @ axis) > STREAK:
            out[members] = 0
    return out


def whole_gantries(label: NDArray[np.integer], instance: NDArray[np.integer]) -> NDArray[np.int16]:
    """Assign the signs of a gantry to the class of the gantry, an object of 25 m across the road."""
    gantry = TAXONOMY["gantry"]
    numbers = np.unique(instance[label == gantry])
    return np.where(np.isin(instance, numbers[numbers > 0]), gantry, label).astype(np.int16)

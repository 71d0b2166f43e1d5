"""Streets from which the judge of the inventory's objects learns: simulated, labelled by `general`, and disturbed.

On recordings `general` is wrong more often than on simulated streets, and poles lean more. Disturbed streets have both:
the logarithms of the class probabilities get normal noise per class, for the street as a whole and for cubes of 3 m,
and are flattened; the street is sheared. With noise of strength 1 the mean IoU of `general` on eight common classes
falls from 0.64 to 0.51, which is what it reaches on recordings (docs/benchmarks.md).
"""

from __future__ import annotations

import zlib
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from mlsroad_pipeline.algorithms.baselines.boosted_trees.labeller import (
    describe_scene,
    parameters_of,
    voxel_probabilities,
)
from mlsroad_pipeline.algorithms.core.classes import TAXONOMY_NAMES
from mlsroad_pipeline.algorithms.inventory.class_groups import ClassEvidence, evidence_of_labels, group_shares
from mlsroad_pipeline.algorithms.inventory.rules import KIND_OF_CLASS
from mlsroad_pipeline.algorithms.models.bundle import bundle_scheme
from mlsroad_pipeline.algorithms.stages import GroundParameters, find_ground
from mlsroad_pipeline.datasets.models.bundle_files import load_bundle
from mlsroad_pipeline.datasets.models.shipped_models import FOLDER as MODELS
from mlsroad_pipeline.simulation import simulate_survey
from mlsroad_pipeline.simulation.parameters.presets import simulation_parameters

STREETS = [
    "residential", "old_town", "american_suburb", "downtown", "town", "suburb", "industrial", "rural",
    "asian_arterial", "campus", "ring_road",
]  # fmt: skip
SURVEYS: dict[str, dict[str, Any]] = {
    "tr": {"count": 66, "seed": 9001, "length": 70.0, "variety": 0.5,
           "presets": ["demo", "small", "oakland", "hdl32", "sick_side", "mx9", "hdl64", "pandaset"]},
    "tq": {"count": 88, "seed": 9101, "length": 80.0, "variety": 0.3,
           "presets": ["small", "demo", "sick_side", "oakland"]},
    "tm": {"count": 11, "seed": 9201, "length": 25.0, "variety": 0.3, "presets": ["mx9"]},
}  # fmt: skip
MOST_POINTS = 2_500_000
LEAST_POINTS = {"pole": 20, "sign": 10, "vehicle": 50, "tree": 100}
CLEAN, LABELS, DISTURBED = "clean", "labels", ("disturbed_1", "disturbed_2")
"""Variants of a street: as labelled; with classes and confidences alone; disturbed."""

NOISE, FLATNESS, CUBE = 0.7, 0.3, 3.0
"""Standard deviations of the noise of log probabilities and of the logarithm of their factor; edge of the cubes, m."""

STRENGTH = (0.3, 1.4)
"""Range of the strength of the noise of a street, a factor of `NOISE` and `FLATNESS`."""

SHEAR = 0.035
"""Standard deviation of the shear along each axis, metres per metre of height: 2 degrees."""

BUNDLE = load_bundle(MODELS / "general")
SCHEME = bundle_scheme(BUNDLE)
TRUE_KINDS = {name: kind for name, kind in KIND_OF_CLASS.items() if name != "cycas"}  # low vegetation of the scheme


class Street(NamedTuple):
    """A labelled street: points, heights, class probabilities, true class and object per point, true objects."""

    name: str
    local: np.ndarray
    origin: np.ndarray
    height: np.ndarray
    evidence: ClassEvidence
    truth: np.ndarray
    instance: np.ndarray
    objects: pd.DataFrame


def make_street(name: str, config: dict[str, Any], folder: Path) -> None:
    """Simulate and label a street and store it; streets of too many points are stored empty."""
    survey = simulate_survey(simulation_parameters(config), n_threads=1)
    cloud, path = survey.cloud, folder / f"{name}.npz"
    if len(cloud) > MOST_POINTS:
        np.savez(path, xyz=np.zeros((0, 3), np.float32))
        return
    ground = find_ground(cloud, GroundParameters(**BUNDLE.metadata["parameters"]["ground"]))
    voxels = describe_scene(cloud.with_columns(**ground), ground, voxel_size=parameters_of(BUNDLE).voxel_size)
    survey.objects.to_pickle(folder / f"{name}.pkl")
    np.savez(
        path, xyz=cloud.xyz.astype(np.float32), origin=survey.origin, height=ground["height"],
        owner=voxels.owner.astype(np.int32), prob=voxel_probabilities(voxels, BUNDLE).astype(np.float16),
        truth=cloud["label"].astype(np.uint8), instance=cloud["instance"].astype(np.int32),
    )  # fmt: skip


def read_street(name: str, folder: Path, variant: str = CLEAN) -> Street | None:
    """Return a variant of a stored street; None for streets of too many points."""
    with np.load(folder / f"{name}.npz") as stored:
        arrays = dict(stored)
    if not 0 < len(arrays["xyz"]) <= MOST_POINTS:
        return None
    probabilities, owner = arrays["prob"].astype(np.float32), arrays["owner"].astype(np.int64)
    if variant == LABELS:
        evidence = evidence_of_labels(probabilities.argmax(axis=1)[owner], probabilities.max(axis=1)[owner], SCHEME)
    else:
        evidence = ClassEvidence(probabilities, owner, group_shares(SCHEME))
    known = np.isfinite(arrays["height"])
    evidence = ClassEvidence(evidence.probabilities, np.where(known, evidence.owner, -1), evidence.groups)
    street = Street(
        name, arrays["xyz"].astype(np.float64), arrays["origin"].astype(np.float64),
        np.where(known, arrays["height"], 0.0).astype(np.float64), evidence, arrays["truth"], arrays["instance"],
        pd.read_pickle(folder / f"{name}.pkl"),
    )  # fmt: skip
    return disturb(street, zlib.crc32(f"{name} {variant}".encode())) if variant in DISTURBED else street


def disturb(street: Street, seed: int) -> Street:
    """Return a street with noise in its class probabilities, and sheared."""
    rng = np.random.default_rng(seed)
    strength = rng.uniform(*STRENGTH)
    owner, probabilities = street.evidence.owner, street.evidence.probabilities
    known, n, n_classes = owner >= 0, len(probabilities), probabilities.shape[1]
    size = np.maximum(np.bincount(owner[known], minlength=n), 1)
    totals = [np.bincount(owner[known], weights=street.local[known, k], minlength=n) for k in range(3)]
    middle = np.stack(totals, axis=1) / size[:, None]
    cube = np.unique(np.floor(middle / CUBE).astype(np.int64), axis=0, return_inverse=True)[1].ravel()
    logits = np.log(probabilities.astype(np.float64) + 1e-3) * np.exp(-abs(rng.normal(0.0, FLATNESS * strength)))
    logits += rng.normal(0.0, NOISE * strength, n_classes)
    logits += rng.normal(0.0, NOISE * strength, (int(cube.max()) + 1, n_classes))[cube]
    disturbed = np.exp(logits - logits.max(axis=1, keepdims=True))
    disturbed /= disturbed.sum(axis=1, keepdims=True)
    local = street.local.copy()
    local[:, :2] += street.height[:, None] * rng.normal(0.0, SHEAR, 2)
    return street._replace(
        local=local, evidence=ClassEvidence(disturbed.astype(np.float32), owner, street.evidence.groups)
    )


def true_objects(street: Street) -> pd.DataFrame:
    """Return the true objects of the kinds with their places, and whether they count: not moving, enough points."""
    table = street.objects
    counts = np.bincount(np.maximum(street.instance, 0), minlength=int(table["instance"].max()) + 1)
    kind = table["label"].map(lambda code: TRUE_KINDS.get(TAXONOMY_NAMES[code]))
    vehicle, panel = (kind == "vehicle").to_numpy(), ((kind == "sign") & table["panel_x"].notna()).to_numpy()
    x = np.where(vehicle, table["box_x"], np.where(panel, table["panel_x"], table["x"]))
    y = np.where(vehicle, table["box_y"], np.where(panel, table["panel_y"], table["y"]))
    n_points = counts[table["instance"].to_numpy()]
    enough = n_points >= kind.map(LEAST_POINTS).fillna(np.inf).to_numpy()
    counted = enough & ~table["moving"].to_numpy(bool)
    return pd.DataFrame({
        "kind": kind, "x": x, "y": y, "counted": counted, "instance": table["instance"], "length": table["length"],
    })[kind.notna().to_numpy()].reset_index(drop=True)  # fmt: skip

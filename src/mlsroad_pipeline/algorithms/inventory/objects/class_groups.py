"""Groups of classes whose probabilities are evidence for objects, the same for every class scheme."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import ClassScheme

_MEMBERS: dict[str, tuple[str, ...]] = {
    "paved ground": ("road", "lane_marking", "parking", "sidewalk", "curb", "manhole", "other_ground"),
    "natural ground": ("grass", "soil", "trail"),
    "tree": ("trunk", "tree", "palm"),
    "low vegetation": ("cycas", "brushwood", "hedge", "other_vegetation"),
    "building": ("building",),
    "wall": ("wall", "fence", "stairs", "bridge", "guardrail", "other_structure"),
    "pole": ("utility_pole", "light_pole", "traffic_light", "post", "gantry", "transformer"),
    "sign": ("traffic_sign", "station_sign"),
    "wire": ("wire", "support_wire"),
    "vehicle": ("car", "van", "truck", "bus", "train", "other_vehicle"),
}

GROUPS = (*_MEMBERS, "other")
"""Groups of taxonomy classes."""


@dataclass(frozen=True)
class ClassEvidence:
    """Class probabilities of the points of a scene, for voxels or for single points."""

    probabilities: NDArray[np.float32]  # Class probabilities of each voxel; rows sum to 1
    owner: NDArray[np.integer]  # Voxel of each point; -1 for points without a class, such as outliers
    groups: NDArray[np.float32]  # Share of each class in each group, see `group_shares`

    @cached_property
    def of_groups(self) -> NDArray[np.float32]:
        """Probabilities of the groups of each voxel, shape (m, len(GROUPS))."""
        grouped: NDArray[np.float32] = (self.probabilities @ self.groups).astype(np.float32)
        return grouped


def group_shares(scheme: ClassScheme) -> NDArray[np.float32]:
    """Return how the classes of a scheme fall into `GROUPS`."""
    of_member = {member: k for k, members in enumerate(_MEMBERS.values()) for member in members}
    shares = np.zeros((len(scheme), len(GROUPS)), dtype=np.float32)
    for row, members in enumerate(scheme.members):
        for member in members:
            shares[row, of_member.get(member, len(GROUPS) - 1)] += 1.0 / len(members)
        if not members:
            shares[row, -1] = 1.0
    return shares


def evidence_of_soft_labels(
    labels: NDArray[np.integer],
    confidence: NDArray[np.floating],
    probabilities: NDArray[np.float32] | None,
    owner: NDArray[np.integer] | None,
    *,
    scheme: ClassScheme,
) -> ClassEvidence:
    """Return the evidence of labels: that of the probabilities, and of a method without them `evidence_of_labels`."""
    if probabilities is None or owner is None:
        return evidence_of_labels(labels, confidence, scheme)
    return ClassEvidence(probabilities, owner, group_shares(scheme))


def evidence_of_labels(
    labels: NDArray[np.integer], confidence: NDArray[np.floating], scheme: ClassScheme
) -> ClassEvidence:
    """Return the evidence of a method that gives a class and a confidence, but no probabilities."""
    n_classes, steps = len(scheme), 50
    level = np.round(np.clip(np.nan_to_num(confidence.astype(np.float64)), 0.0, 1.0) * steps).astype(np.int64)
    own = np.repeat(np.arange(n_classes), steps + 1)
    p = np.tile(np.arange(steps + 1) / steps, n_classes)
    table = np.repeat(((1.0 - p) / max(n_classes - 1, 1))[:, None], n_classes, axis=1)
    table[np.arange(len(own)), own] = p
    owner = np.where(labels < 0, -1, labels.astype(np.int64) * (steps + 1) + level)
    return ClassEvidence(table.astype(np.float32), owner, group_shares(scheme))

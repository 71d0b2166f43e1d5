"""What can be measured on a built mesh, as truth for those who measure it on points: tilt of masts, plates of signs."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from mlsroad_pipeline.algorithms.classes import TAXONOMY
from mlsroad_pipeline.algorithms.exceptions import ParameterError
from mlsroad_pipeline.algorithms.simulation.meshes import KIND, LABEL, RETRO, Mesh
from mlsroad_pipeline.algorithms.simulation.objects.parts import UNDERGROUND


class Plates(NamedTuple):
    """The plates of traffic signs on a mesh, the largest first.

    Parameters
    ----------
    centre : ndarray of shape (p, 3), float64
        Their middles, metres.
    yaw : ndarray of shape (p,), float64
        Where they look, radians counter-clockwise from +x.
    width, height : ndarray of shape (p,), float64
        Metres.
    """

    centre: NDArray[np.float64]
    yaw: NDArray[np.float64]
    width: NDArray[np.float64]
    height: NDArray[np.float64]


def tilt(mesh: Mesh) -> float:
    """Return by how much a mast leans: its foot was cut level before it was leaned.

    Parameters
    ----------
    mesh : Mesh
        A pole, sign or light of this package, which reaches below the ground.

    Returns
    -------
    float
        Angle between its axis and the vertical, degrees.

    Raises
    ------
    ParameterError
        If the mesh does not reach below the ground.
    """
    z = mesh.vertices[:, 2]
    if z.min() > -0.5 * UNDERGROUND:
        raise ParameterError(f"the mesh ends {z.min():.2f} m above the ground: only what is let into it has a foot")
    foot = mesh.vertices[z < z.min() + 0.1]
    axis = np.linalg.svd(foot - foot.mean(axis=0), full_matrices=False)[2][2]
    return float(np.degrees(np.arccos(min(abs(axis[2]), 1.0))))


def sign_plates(mesh: Mesh) -> Plates:
    """Return the plates of traffic signs that a mesh carries.

    Parameters
    ----------
    mesh : Mesh
        Any mesh of this package.

    Returns
    -------
    Plates
        One entry per plate: border, field and marks count as one.
    """
    chosen = (mesh.attributes[:, LABEL] == TAXONOMY["traffic_sign"]) & (mesh.attributes[:, KIND] == RETRO)
    faces = mesh.faces[chosen]
    used, corners = np.unique(faces, return_inverse=True)
    corners = corners.reshape(-1, 3)
    links = np.concatenate([corners[:, :2], corners[:, 1:]])
    graph = coo_array((np.ones(len(links), dtype=bool), (links[:, 0], links[:, 1])), shape=(len(used), len(used)))
    part = connected_components(graph, directed=False)[1][corners[:, 0]] if len(used) else np.zeros(0, dtype=int)
    triangles = mesh.vertices[faces]
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]) / 2
    sheets = [_sheet(triangles[part == k].reshape(-1, 3), normals[part == k].sum(axis=0)) for k in np.unique(part)]
    kept: list[tuple[float, NDArray[np.float64], NDArray[np.float64], float, float]] = []
    for sheet in sorted(sheets, key=lambda s: -s[0]):
        _, middle, normal, _, _ = sheet
        inside = (
            abs((middle - m) @ n) < 0.03 and abs(normal @ n) > 0.98 and np.linalg.norm(middle - m) < max(w, h) / 2
            for _, m, n, w, h in kept
        )
        if not any(inside):
            kept.append(sheet)
    yaw = [float(np.arctan2(n[1], n[0])) for _, _, n, _, _ in kept]
    return Plates(
        np.array([m for _, m, _, _, _ in kept]).reshape(-1, 3), np.array(yaw), np.array([s[3] for s in kept]),
        np.array([s[4] for s in kept]),
    )  # fmt: skip


def _sheet(
    points: NDArray[np.float64], area: NDArray[np.float64]
) -> tuple[float, NDArray[np.float64], NDArray[np.float64], float, float]:
    """Return area, middle, unit normal, width and height of one flat sheet."""
    size = float(np.linalg.norm(area))
    normal = area / size
    right = np.array([-normal[1], normal[0], 0.0]) / np.hypot(normal[0], normal[1])
    up = np.cross(normal, right)
    u, v = points @ right, points @ up
    middle = (u.max() + u.min()) / 2 * right + (v.max() + v.min()) / 2 * up + (points[0] @ normal) * normal
    return size, middle, normal, float(np.ptp(u)), float(np.ptp(v))

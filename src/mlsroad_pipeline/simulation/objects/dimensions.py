"""Measures of built meshes as truth: lean of masts, plates of signs."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY
from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.simulation.model.meshes import KIND, LABEL, RETRO, Mesh
from mlsroad_pipeline.simulation.objects.parts import UNDERGROUND


class Plates(NamedTuple):
    """Plates of traffic signs on a mesh, the largest first."""

    centre: NDArray[np.float64]  # Their middles, metres
    yaw: NDArray[np.float64]  # Directions that they face, radians counter-clockwise from +x
    width: NDArray[np.float64]  # Metres
    height: NDArray[np.float64]  # Metres


class Measures(NamedTuple):
    """Attributes of a pole or a sign in an asset register, beside its box; NaN where not applicable."""

    tilt: float = np.nan  # Angle between the axis and the vertical, degrees
    # Direction of the lean, degrees clockwise from grid north; without meaning at a tilt of 0
    lean_azimuth: float = np.nan
    panels: int = 0  # Number of plates of traffic signs; the other fields are those of the largest
    # panel_bottom, panel_centre: heights of its lower edge and its middle above the base, metres
    panel_bottom: float = np.nan
    panel_centre: float = np.nan
    panel_width: float = np.nan  # Metres
    panel_height: float = np.nan  # Metres
    panel_azimuth: float = np.nan  # Direction that its front faces, degrees clockwise from grid north
    # panel_x, panel_y: its middle, metres, in the frame of the mesh
    panel_x: float = np.nan
    panel_y: float = np.nan


_MASTS = tuple(TAXONOMY[name] for name in ("light_pole", "utility_pole", "traffic_light", "traffic_sign", "gantry"))


def measure(mesh: Mesh, label: int, base: NDArray[np.float64]) -> Measures:
    """Measure a placed pole or sign (x east, y north, metres) with a base point.

    Other objects have NaN and no panels. Plates on other objects have no tilt.
    """
    if label not in _MASTS:
        return Measures()
    found = Measures()
    if mesh.vertices[:, 2].min() - base[2] < -0.5 * UNDERGROUND:
        axis = _axis(mesh)
        found = found._replace(tilt=_off_vertical(axis), lean_azimuth=_azimuth(axis[0], axis[1]))
    plates = sign_plates(mesh)
    if len(plates.yaw) == 0:
        return found
    (x, y, z), yaw = plates.centre[0], plates.yaw[0]
    width, height = float(plates.width[0]), float(plates.height[0])
    return found._replace(
        panels=len(plates.yaw), panel_bottom=float(z - base[2] - height / 2), panel_centre=float(z - base[2]),
        panel_width=width, panel_height=height, panel_azimuth=_azimuth(np.cos(yaw), np.sin(yaw)),
        panel_x=float(x), panel_y=float(y),
    )  # fmt: skip


def _azimuth(east: float, north: float) -> float:
    return float(np.degrees(np.arctan2(east, north)) % 360.0)


def _off_vertical(axis: NDArray[np.float64]) -> float:
    return float(np.degrees(np.arctan2(np.hypot(axis[0], axis[1]), axis[2])))


def _axis(mesh: Mesh) -> NDArray[np.float64]:
    """Return the upward unit axis of a mast, from its foot, which was level before the mast was leaned."""
    z = mesh.vertices[:, 2]
    foot = mesh.vertices[z < z.min() + 0.1]
    axis = np.linalg.svd(foot - foot.mean(axis=0), full_matrices=False)[2][2]
    return np.asarray(axis if axis[2] >= 0 else -axis)


def tilt(mesh: Mesh) -> float:
    """Return the angle in degrees between a mast's axis and the vertical; the mesh must reach below the ground."""
    z = mesh.vertices[:, 2]
    if z.min() > -0.5 * UNDERGROUND:
        raise ParameterError(f"the mesh ends at a height of {z.min():.2f} m: extend the foot below the ground")
    return _off_vertical(_axis(mesh))


def sign_plates(mesh: Mesh) -> Plates:
    """Return the plates of traffic signs on a mesh; border, field and marks count as one plate."""
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

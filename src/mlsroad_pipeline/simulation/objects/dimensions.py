"""Measures of built meshes as truth: lean of masts, plates of signs."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY
from mlsroad_pipeline.simulation.model.meshes import KIND, LABEL, RETRO, Mesh
from mlsroad_pipeline.simulation.objects.parts import UNDERGROUND


class Plate(NamedTuple):
    """Plate of a traffic sign on a mesh."""

    area: float  # Square metres
    centre: NDArray[np.float64]  # Its middle, metres
    normal: NDArray[np.float64]  # Unit vector that its front faces
    width: float  # Metres
    height: float  # Metres

    @property
    def yaw(self) -> float:
        """Direction that it faces, radians counter-clockwise from +x."""
        return float(np.arctan2(self.normal[1], self.normal[0]))


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
    """Measure a placed pole or sign; other objects have NaN and no panels, and plates on other objects have no tilt."""
    if label not in _MASTS:
        return Measures()
    found = Measures()
    z = mesh.vertices[:, 2]
    if z.min() - base[2] < -0.5 * UNDERGROUND:
        # The foot was level before the mast was leaned.
        foot = mesh.vertices[z < z.min() + 0.1]
        axis = np.linalg.svd(foot - foot.mean(axis=0), full_matrices=False)[2][2]
        axis = axis if axis[2] >= 0 else -axis
        lean = float(np.degrees(np.arctan2(np.hypot(axis[0], axis[1]), axis[2])))
        found = found._replace(tilt=lean, lean_azimuth=_azimuth(axis[0], axis[1]))
    plates = sign_plates(mesh)
    if not plates:
        return found
    largest = plates[0]
    x, y, above = (float(c) for c in largest.centre - [0.0, 0.0, base[2]])
    return found._replace(
        panels=len(plates), panel_bottom=above - largest.height / 2, panel_centre=above, panel_width=largest.width,
        panel_height=largest.height, panel_azimuth=_azimuth(np.cos(largest.yaw), np.sin(largest.yaw)),
        panel_x=x, panel_y=y,
    )  # fmt: skip


def _azimuth(east: float, north: float) -> float:
    return float(np.degrees(np.arctan2(east, north)) % 360.0)


def sign_plates(mesh: Mesh) -> list[Plate]:
    """Return the plates of traffic signs on a mesh, the largest first; border, field and marks count as one plate."""
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
    kept: list[Plate] = []
    for sheet in sorted(sheets, key=lambda s: -s.area):
        apart = [(sheet.centre - other.centre, other) for other in kept]
        inside = (
            abs(shift @ other.normal) < 0.03
            and abs(sheet.normal @ other.normal) > 0.98
            and np.linalg.norm(shift) < max(other.width, other.height) / 2
            for shift, other in apart
        )
        if not any(inside):
            kept.append(sheet)
    return kept


def _sheet(points: NDArray[np.float64], area: NDArray[np.float64]) -> Plate:
    """Return one flat sheet, given its corners and the sum of its faces' area vectors."""
    size = float(np.linalg.norm(area))
    normal = area / size
    right = np.array([-normal[1], normal[0], 0.0]) / np.hypot(normal[0], normal[1])
    up = np.cross(normal, right)
    u, v = points @ right, points @ up
    middle = (u.max() + u.min()) / 2 * right + (v.max() + v.min()) / 2 * up + (points[0] @ normal) * normal
    return Plate(size, middle, normal, float(np.ptp(u)), float(np.ptp(v)))

"""Contact sheets of the designs of street objects, as photographs or as scanned points."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import open3d as o3d
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY_NAMES
from mlsroad_pipeline.algorithms.core.palette import class_palette
from mlsroad_pipeline.reporting.clouds.splatting import render_points
from mlsroad_pipeline.reporting.clouds.view import View
from mlsroad_pipeline.simulation.model.meshes import BLUE, LABEL, RED, Design, Mesh

_SUN = np.array([0.35, -0.62, 0.70])
_SKY = 0.45  # ambient light relative to that of the sun


def _rays(origins: NDArray, directions: NDArray) -> NDArray[np.float32]:
    pairs = np.broadcast_arrays(origins, directions)
    return np.concatenate(pairs, axis=-1).reshape(-1, 6).astype(np.float32)


def _ray_scene(mesh: Mesh) -> o3d.t.geometry.RaycastingScene:
    scene = o3d.t.geometry.RaycastingScene(nthreads=1)
    scene.add_triangles(
        o3d.core.Tensor.from_numpy(mesh.vertices.astype(np.float32)),
        o3d.core.Tensor.from_numpy(mesh.faces.astype(np.uint32)),
    )
    return scene


def _cast(scene: o3d.t.geometry.RaycastingScene, rays: NDArray[np.float32]) -> tuple[NDArray, NDArray, NDArray]:
    hits = scene.cast_rays(o3d.core.Tensor.from_numpy(rays))
    distance = hits["t_hit"].numpy()
    hit = np.flatnonzero(np.isfinite(distance))
    return hit, distance[hit], hits["primitive_ids"].numpy()[hit].astype(np.int64)


def _sunlit(scene: o3d.t.geometry.RaycastingScene, mesh: Mesh, places: NDArray, face: NDArray) -> NDArray[np.uint8]:
    """Return the display colours of places in sunlight and ambient light."""
    a, b, c = (mesh.vertices[mesh.faces[face, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True) + 1e-12
    towards = np.abs(normal @ _SUN)
    dark = scene.test_occlusions(o3d.core.Tensor.from_numpy(_rays(places + 0.01 * _SUN, _SUN))).numpy()
    light = (_SKY * (0.6 + 0.4 * np.abs(normal[:, 2])) + np.where(dark, 0.0, towards))[:, None]
    albedo = mesh.attributes[face, RED : BLUE + 1]
    return (255 * np.clip(1.1 * albedo * light, 0, 1) ** (1 / 2.2)).astype(np.uint8)


def _axes(azimuth: float, elevation: float) -> tuple[NDArray, NDArray, NDArray]:
    """Return the right, up and backward axes of a picture."""
    right = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    level = np.array([np.sin(azimuth), -np.cos(azimuth), 0.0])
    back = np.cos(elevation) * level + np.array([0.0, 0.0, np.sin(elevation)])
    return right, np.cross(back, right), back


def photograph(
    mesh: Mesh, *, size: tuple[int, int] = (240, 240), span: float | None = None, azimuth: float = -0.6,
    elevation: float = 0.2,
) -> NDArray[np.uint8]:  # fmt: skip
    """Render a mesh in sunlight in parallel projection, with its foot near the lower edge."""
    width, height = size
    right, up, back = _axes(azimuth, elevation)
    # Parts below the ground are cut off; a post has no vertex at the ground.
    shown = mesh.vertices * [1, 1, 0] + np.maximum(mesh.vertices, 0) * [0, 0, 1]
    x, y = shown @ right, shown @ up
    if span is None:
        span = 1.06 * max(float(np.ptp(y)), float(np.ptp(x)) * height / width)
    pixel = span / height
    across = (np.arange(width) - width / 2 + 0.5) * pixel + (x.min() + x.max()) / 2
    down = y.min() - 0.03 * span + span - (np.arange(height) + 0.5) * pixel
    far = 4 * span + 50.0
    origins = across[None, :, None] * right + down[:, None, None] * up + far * back
    rays = _rays(origins, -back)
    scene = _ray_scene(mesh)
    hit, distance, face = _cast(scene, rays)
    picture = np.full((height * width, 3), 255, dtype=np.uint8)
    above = (rays[hit, 2] - distance * back[2]) > -0.05
    hit, distance, face = hit[above], distance[above], face[above]
    picture[hit] = _sunlit(scene, mesh, rays[hit, :3] - distance[:, None] * back, face)
    return picture.reshape(height, width, 3)


def scan_mesh(
    mesh: Mesh, *, distance: float = 6.0, spacing: float = 0.03, scanner_height: float = 2.3, slant: float = 0.785
) -> tuple[NDArray[np.float64], NDArray[np.uint8], NDArray[np.int64]]:
    """Scan a mesh from a van driving along x, with one scanner slanted forward and one backward."""
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    scene = _ray_scene(mesh)
    places, faces = [], []
    angle = np.arange(-np.pi / 2, np.pi / 2, spacing / distance)
    reach = (distance + max(high[1], 0.0)) * np.tan(abs(slant)) + 2 * spacing
    for sign in (-1.0, 1.0):
        ahead = np.array([np.sin(sign * slant), np.cos(sign * slant), 0.0])
        directions = np.cos(angle)[:, None] * ahead + np.sin(angle)[:, None] * np.array([0.0, 0.0, 1.0])
        x = np.arange(low[0] - reach, high[0] + reach, spacing)
        origins = np.column_stack([x, np.full_like(x, -distance), np.full_like(x, scanner_height)])
        rays = _rays(origins[:, None], directions[None])
        hit, t, face = _cast(scene, rays)
        places.append(rays[hit, :3].astype(np.float64) + t[:, None] * rays[hit, 3:])
        faces.append(face)
    xyz, struck = np.concatenate(places), np.concatenate(faces)
    above = xyz[:, 2] >= 0
    xyz, struck = xyz[above], struck[above]
    return xyz, _sunlit(scene, mesh, xyz, struck), struck


def _scanned_picture(
    mesh: Mesh, size: tuple[int, int], labelled: bool, azimuth: float, elevation: float
) -> NDArray[np.uint8]:
    """Render the points of a scan of a mesh."""
    xyz, rgb, face = scan_mesh(mesh)
    if labelled:
        names = tuple(TAXONOMY_NAMES.values())
        codes = np.array(list(TAXONOMY_NAMES))
        rgb = class_palette(names)[np.searchsorted(codes, mesh.attributes[face, LABEL].astype(np.int64))]
    right, up, back = _axes(azimuth, elevation)
    x, y = xyz @ right, xyz @ up
    span = 1.06 * max(float(np.ptp(y)), float(np.ptp(x)) * size[1] / size[0])
    centre = right * (x.min() + x.max()) / 2 + up * (y.min() - 0.03 * span + span / 2)
    view = View(np.stack([right, -up, -back]), centre, size[1] / span, size, False)
    return render_points(xyz, rgb, view, splat_metres=0.03, gap=0)


def design_sheet(
    designs: Sequence[Design], *, seeds: Sequence[int] = (1, 2, 3, 4), cell: tuple[int, int] = (220, 220),
    style: str = "photograph", azimuth: float = -0.6, elevation: float = 0.2,
) -> Figure:  # fmt: skip
    """Draw several individuals of every design, one row per design, as ``photograph``, ``points`` or ``labels``."""
    width, height = cell[0] / 100, (cell[1] + 34) / 100
    figure = Figure(figsize=(width * len(seeds), height * len(designs)), dpi=100, facecolor="white")
    FigureCanvasAgg(figure)
    for row, design in enumerate(designs):
        for column, seed in enumerate(seeds):
            mesh = design.build(np.random.default_rng(seed))
            if style == "photograph":
                picture = photograph(mesh, size=cell, azimuth=azimuth, elevation=elevation)
            else:
                picture = _scanned_picture(mesh, cell, style == "labels", azimuth, elevation)
            bottom = (len(designs) - 1 - row) / len(designs)
            share = cell[1] / (cell[1] + 34) / len(designs)
            axes = figure.add_axes((column / len(seeds), bottom, 1 / len(seeds), share))
            axes.imshow(picture, aspect="auto")
            axes.set_axis_off()
            extent = np.ptp(mesh.vertices[:, :2], axis=0).max()
            name = f"{design.name}\n" if column == 0 else ""
            title = f"{name}{mesh.vertices[:, 2].max():.1f} x {extent:.1f} m"
            axes.set_title(title, fontsize=6.5, pad=3)
    return figure

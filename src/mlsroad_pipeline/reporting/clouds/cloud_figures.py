"""Figures of labelled clouds: truth, prediction and errors in one view, with a legend."""

import hashlib
import threading
from collections import OrderedDict
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Rectangle
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.palette import (
    CORRECT_COLOUR,
    HIT_COLOUR,
    IGNORED_COLOUR,
    MISSED_COLOUR,
    WRONG_COLOUR,
    class_palette,
    error_colours,
    outcome_colours,
    rgb_to_hex,
)
from mlsroad_pipeline.algorithms.core.validation import check_column, check_xyz
from mlsroad_pipeline.reporting.clouds.splatting import close_gaps, depth_shading, nearest_points, shaded_picture
from mlsroad_pipeline.reporting.clouds.view import View, scale_length

_DPI = 150
_VIEWS_KEPT = 2
_LAST_SEEN: OrderedDict[bytes, tuple[NDArray[np.int64], NDArray[np.float32]]] = OrderedDict()
_LOCK = threading.Lock()
_LEGEND_INCHES = 1.9
_TITLE_INCHES = 0.32
INK = "#22262e"
"""Colour of text and lines in every figure."""
_OWN_LEGENDS = {
    "errors": ("Errors", (("right", CORRECT_COLOUR), ("wrong", WRONG_COLOUR))),
    "detections": ("Detections", (("right", HIT_COLOUR), ("missed", MISSED_COLOUR), ("false", WRONG_COLOUR))),
}
"""Panels whose colours are not classes, to the heading and entries of their legend."""


def _labels(values: ArrayLike, n_points: int, n_classes: int, name: str) -> NDArray[np.int64]:
    """Return validated labels as int64 indices of a palette."""
    labels = check_column(values, n_points, name).astype(np.int64)
    if len(labels) and not (labels.min() >= -1 and labels.max() < n_classes):
        raise DataError(f"{name} labels must be in -1..{n_classes - 1}, got {labels.min()}..{labels.max()}")
    return labels


def _seen(
    points: NDArray[np.floating], large: View, splat_metres: float, reach: int
) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """Return the point and the brightness of each pixel; the last views are cached.

    All methods of a comparison are drawn with the same points and views, and visibility takes most of the time.
    """
    digest = hashlib.blake2b(np.ascontiguousarray(points).data, digest_size=16)
    place = (large.rotation.tolist(), large.centre.tolist(), large.scale, large.size, large.perspective)
    digest.update(repr((points.dtype, place, splat_metres, reach)).encode())
    key = digest.digest()
    with _LOCK:
        if key in _LAST_SEEN:
            return _LAST_SEEN[key]
    index, depth = nearest_points(points, large, splat_metres=splat_metres)
    index, depth = close_gaps(index, depth, reach=reach)
    rendered = index, depth_shading(depth, large)
    with _LOCK:
        _LAST_SEEN[key] = rendered
        while len(_LAST_SEEN) > _VIEWS_KEPT:
            _LAST_SEEN.popitem(last=False)
    return rendered


def labelling_pictures(
    xyz: ArrayLike,
    view: View,
    *,
    classes: ClassScheme | tuple[str, ...],
    truth: ArrayLike | None = None,
    predicted: ArrayLike | None = None,
    splat_metres: float = 0.05,
    oversampling: int = 2,
) -> dict[str, NDArray[np.uint8]]:
    """Render truth, prediction and errors of a cloud in one view."""
    points = check_xyz(xyz)
    palette = class_palette(classes)
    labels = {
        name: _labels(values, len(points), len(palette) - 1, name)
        for name, values in (("truth", truth), ("prediction", predicted))
        if values is not None
    }
    colours = {name: palette[values] for name, values in labels.items()}
    if len(labels) == 2:
        colours["errors"] = error_colours(labels["truth"], labels["prediction"])
    return _painted(points, view, colours, splat_metres, oversampling)


def detection_pictures(
    xyz: ArrayLike, view: View, *, classes: ClassScheme | tuple[str, ...], truth: ArrayLike, outcomes: ArrayLike
) -> dict[str, NDArray[np.uint8]]:
    """Render the reference objects and the detections of a cloud in one view."""
    points = check_xyz(xyz)
    palette = class_palette(classes)
    colours = {
        "truth": palette[_labels(truth, len(points), len(palette) - 1, "truth")],
        "detections": outcome_colours(_labels(outcomes, len(points), 3, "outcomes")),
    }
    return _painted(points, view, colours, splat_metres=0.05, oversampling=2)


def _painted(
    points: NDArray[np.floating],
    view: View,
    colours: Mapping[str, NDArray[np.uint8]],
    splat_metres: float,
    oversampling: int,
) -> dict[str, NDArray[np.uint8]]:
    """Render a cloud in several colourings; visibility is computed once."""
    index, shade = _seen(points, view.enlarged(oversampling), splat_metres, 3 * oversampling)
    return {name: shaded_picture(index, shade, paint, oversampling=oversampling) for name, paint in colours.items()}


def cloud_figure(
    pictures: Mapping[str, NDArray[np.uint8]],
    view: View,
    *,
    classes: ClassScheme | tuple[str, ...],
    present: ArrayLike | None = None,
    title: str = "",
) -> Figure:
    """Arrange pictures of one view with a legend and, for orthographic views, a scale bar."""
    rows, columns = next(iter(pictures.values())).shape[:2]
    stacked = columns >= 1.4 * rows
    across, down = (1, len(pictures)) if stacked else (len(pictures), 1)
    panel_width = 9.0 if stacked else 12.0 / across
    panel_height = panel_width * rows / columns
    head = 0.45 if title else 0.08
    figure_width = across * panel_width + (across - 1) * 0.12 + _LEGEND_INCHES + 0.1
    entries = _legend_entries(classes, present)
    legends = [("Classes", entries), *(_OWN_LEGENDS[name] for name in pictures if name in _OWN_LEGENDS)]
    legends_height = sum(_legend_height(len(named)) for _, named in legends)
    figure_height = max(down * (panel_height + _TITLE_INCHES), legends_height) + head
    figure = Figure(figsize=(figure_width, figure_height), dpi=_DPI, facecolor="white")
    FigureCanvasAgg(figure)
    for k, (name, picture) in enumerate(pictures.items()):
        left = 0.06 + (k % across) * (panel_width + 0.12)
        bottom = figure_height - head - (k // across + 1) * (panel_height + _TITLE_INCHES) + 0.04
        box = (left / figure_width, bottom / figure_height, panel_width / figure_width, panel_height / figure_height)
        axes = figure.add_axes(box)
        axes.imshow(picture, interpolation="antialiased", aspect="auto")
        axes.set_title(name.capitalize(), loc="left", fontsize=10, color=INK, pad=4, fontweight="bold")
        axes.set_xticks([])
        axes.set_yticks([])
        axes.spines[:].set_color("#c8ccd4")
        axes.spines[:].set_linewidth(0.6)
        if not view.perspective:
            _draw_scale_bar(axes, view)
    if title:
        figure.text(0.06 / figure_width, 1 - 0.1 / figure_height, title, fontsize=12, color=INK, va="top")
    top = 1 - head / figure_height
    for heading, named in legends:
        _legend(figure, named, heading, top)
        top -= _legend_height(len(named)) / figure_height
    return figure


def _draw_scale_bar(axes, view: View) -> None:  # type: ignore[no-untyped-def]  # matplotlib is not followed by mypy
    """Draw a bar of a round length in the lower left corner of a panel."""
    width, height = view.size
    metres = scale_length(0.2 * width / view.scale)
    pixels, thickness = metres * view.scale, max(height / 120, 2)
    x, y = 0.018 * width, height - 0.018 * width
    paper = Rectangle((x - 8, y - 0.055 * width), pixels + 16, 0.065 * width, facecolor="white", alpha=0.75, lw=0)
    axes.add_patch(paper)
    axes.add_patch(Rectangle((x, y - thickness), pixels, thickness, facecolor=INK, lw=0))
    axes.text(x + pixels / 2, y - 1.6 * thickness, f"{metres:g} m", ha="center", va="bottom", fontsize=8, color=INK)


def _legend_height(n_entries: int) -> float:
    """Return the height of a legend with its title and the gap below it, inches."""
    return 0.45 + 0.185 * n_entries


def _legend_entries(classes: ClassScheme | tuple[str, ...], present: ArrayLike | None) -> list[tuple[str, ArrayLike]]:
    """Return names and colours of the classes in the figure."""
    names = classes.classes if isinstance(classes, ClassScheme) else tuple(classes)
    palette = class_palette(classes)
    shown = set(range(len(names))) if present is None else {int(label) for label in np.unique(np.asarray(present))}
    entries: list[tuple[str, ArrayLike]] = [
        (name.replace("_", " "), palette[k]) for k, name in enumerate(names) if k in shown
    ]
    return [*entries, ("ignored", np.array(IGNORED_COLOUR))]


def _legend(figure: Figure, entries: Sequence[tuple[str, ArrayLike]], title: str, top: float) -> None:
    """Draw a legend at the right of the figure."""
    handles = [Patch(facecolor=rgb_to_hex(c), edgecolor="#9aa0aa", linewidth=0.4, label=name) for name, c in entries]
    left = 1 - (_LEGEND_INCHES + 0.02) / figure.get_figwidth()
    figure.legend(
        handles=handles, title=title, loc="upper left", bbox_to_anchor=(left, top), frameon=False, fontsize=9,
        title_fontproperties={"weight": "bold", "size": 9}, alignment="left", labelcolor=INK, handlelength=1.3,
        handleheight=1.1, labelspacing=0.45,
    )  # fmt: skip

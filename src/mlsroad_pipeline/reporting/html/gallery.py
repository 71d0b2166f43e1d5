"""Section of a report with groups of small pictures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.reporting.html.parts import data_uri, note


class Picture(NamedTuple):
    """Picture, uint8 of shape (height, width, 3), with its caption."""

    pixels: NDArray[np.uint8]
    caption: str


@dataclass(frozen=True)
class GallerySection:
    """Small pictures in rows, under a heading per group."""

    title: str  # The heading
    groups: Mapping[str, Sequence[Picture]]  # Heading to pictures, in order
    note: str = ""  # A sentence above them

    def body(self) -> str:
        """Return the pictures, embedded."""
        if not any(self.groups.values()):
            return note(self.note) + '<p class="none">Nothing to show.</p>'
        return note(self.note) + "".join(_group(name, pictures) for name, pictures in self.groups.items() if pictures)


def _group(name: str, pictures: Sequence[Picture]) -> str:
    shown = "".join(
        f'<figure><img alt="{escape(picture.caption, quote=True)}" '
        f'width="{picture.pixels.shape[1]}" height="{picture.pixels.shape[0]}" src="{data_uri(picture.pixels)}">'
        f"<figcaption>{escape(picture.caption)}</figcaption></figure>\n"
        for picture in pictures
    )
    return f'<h3>{escape(name)}</h3>\n<div class="gallery">{shown}</div>\n'

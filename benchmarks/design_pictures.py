"""A picture of one individual of every design that a street can be furnished with.

python benchmarks/design_pictures.py [--output docs/images/designs.jpg]
"""

from __future__ import annotations

import argparse
import io
from pathlib import Path

import matplotlib as mpl
import numpy as np
from PIL import Image

from mlsroad_pipeline.reporting.clouds.design_sheet import photograph
from mlsroad_pipeline.simulation.furnishing.catalogue import designs

mpl.use("Agg")
import matplotlib.pyplot as plt

COLUMNS, CELL = 12, 118
FRONTS = {"traffic_sign": 1.0, "station_sign": 1.0, "gantry": 2.6, "light_pole": 2.6, "traffic_light": 2.6}
"""From where classes are seen whose plates look elsewhere than most things do, radians."""


def main() -> None:
    """Paint them, by class, each at its own scale with its height."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, default=Path("docs/images/designs.jpg"))
    output = parser.parse_args().output
    every = [design for group in designs().values() for design in group]
    rows = -(-len(every) // COLUMNS)
    figure, axes = plt.subplots(rows, COLUMNS, figsize=(COLUMNS * 1.3, rows * 1.6), dpi=100)
    for panel in axes.flat:
        panel.axis("off")
    for panel, design in zip(axes.flat, every, strict=False):
        mesh = design.build(np.random.default_rng(1))
        azimuth = FRONTS.get(design.label, -0.6)
        panel.imshow(photograph(mesh, size=(CELL, CELL), azimuth=azimuth))
        name = design.name.replace("_", " ")
        panel.set_title(f"{name}\n{mesh.vertices[:, 2].max():.1f} m", fontsize=5.5, pad=2)
    figure.tight_layout(pad=0.3)
    page = io.BytesIO()
    figure.savefig(page, format="png")
    Image.open(page).convert("RGB").save(output, quality=80)
    print(f"{len(every)} designs: {output}")


if __name__ == "__main__":
    main()

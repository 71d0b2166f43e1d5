"""The truth of a long survey against its points: numbers, classes, boxes, base points.

    python benchmarks/truth.py [--preset vmx450] [--length 2000] [--seed 1] [--threads 2]

Makes the survey piece by piece, keeps no point, and gathers for every instance its number of points, its classes, and
how its points lie in the box of the truth table. Then it says whether every number of a point stands in the table
and the other way round, whether numbers and base points are unique, how many points lie outside their boxes,
and how far base points are from the ground and from the points' own foot. Prints a table and a JSON line.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import replace

import numpy as np
import pandas as pd

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY, TAXONOMY_NAMES
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.simulation import PRESETS
from mlsroad_pipeline.simulation.furnishing.blocks import PASS_INSTANCES
from mlsroad_pipeline.simulation.runtime.survey import SurveyPieces
from mlsroad_pipeline.simulation.street.ground import GROUND_LABELS

SLACK = 0.05  # metres by which noise, the trajectory's error and mixed pixels may take a point out of its box
NUMBERLESS = {*GROUND_LABELS, *(TAXONOMY[k] for k in ("building", "wall", "fence", "hedge", "stairs", "outlier"))}


class Gathered:
    """Running summary of the points of every instance over all pieces."""

    def __init__(self) -> None:
        self.parts: list[pd.DataFrame] = []
        self.points, self.numbered = 0, 0
        self.without: dict[int, int] = {}

    def add(self, cloud: PointCloud, pieces: SurveyPieces) -> None:
        """Add a piece: points that have a number, in the frame of their object's box."""
        number, label = cloud["instance"], cloud["label"]
        rows = np.flatnonzero(number)
        self.points += len(number)
        self.numbered += len(rows)
        for code, count in zip(*np.unique(label[number == 0], return_counts=True), strict=True):
            self.without[int(code)] = self.without.get(int(code), 0) + int(count)
        table = pieces.objects.set_index("instance")
        order = rows[np.argsort(number[rows], kind="stable")]
        mine = table.reindex(number[order])
        xyz = cloud.xyz[order] + pieces.origin
        dx, dy = xyz[:, 0] - mine["box_x"].to_numpy(), xyz[:, 1] - mine["box_y"].to_numpy()
        c, s = np.cos(mine["heading"].to_numpy()), np.sin(mine["heading"].to_numpy())
        along, across = np.abs(c * dx + s * dy), np.abs(c * dy - s * dx)
        up = xyz[:, 2] - mine["z"].to_numpy()
        out = np.maximum.reduce([
            along - mine["length"].to_numpy() / 2, across - mine["width"].to_numpy() / 2,
            up - mine["height"].to_numpy(), -up - 0.3,
        ])  # fmt: skip
        frame = pd.DataFrame({
            "instance": number[order], "known": mine["label"].notna().to_numpy(), "outside": out > SLACK,
            "far": out > 0.3, "low": up, "label": label[order],
        })  # fmt: skip
        groups = frame.groupby("instance")
        self.parts.append(groups.agg(
            points=("label", "size"), known=("known", "all"), outside=("outside", "sum"), far=("far", "sum"),
            low=("low", "min"),
        ))  # fmt: skip

    def table(self) -> pd.DataFrame:
        """Return one row per instance."""
        joined = pd.concat(self.parts).groupby(level=0)
        how = {"points": "sum", "known": "all", "outside": "sum", "far": "sum", "low": "min"}
        return joined.agg(how)


def main() -> None:
    """Simulate, gather and compare."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--preset", default="vmx450", choices=list(PRESETS))
    parser.add_argument("--length", type=float, default=2000.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--passes", type=int, default=1)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--pulse-rate", type=float, help="of each scanner, pulses per second")
    options = parser.parse_args()
    parameters = replace(
        PRESETS[options.preset], length=options.length, seed=options.seed, passes=options.passes, with_images=False,
    )  # fmt: skip
    if options.pulse_rate:
        parameters = replace(parameters, pulse_rate=options.pulse_rate)
    started = time.perf_counter()
    pieces, gathered = SurveyPieces(parameters, n_threads=options.threads), Gathered()
    for cloud, _ in pieces:
        gathered.add(cloud, pieces)
    found, table = gathered.table(), pieces.objects
    still = ~table["moving"].to_numpy()
    stands = still & (table["label"] != TAXONOMY["wire"]).to_numpy()
    alone = stands & (table["design"] != "plate_on_lamp").to_numpy()  # such a plate has the base of its lamp
    local = table[["x", "y", "z"]].to_numpy() - pieces.origin
    ground = pieces.street.ground.height(*pieces.street.alignment.locate(local[stands, :2]))
    steady = found.loc[table.loc[still, "instance"]]
    row = {
        "stage": "truth", "preset": options.preset, "length": options.length, "passes": options.passes,
        "points": gathered.points, "numbered_points": gathered.numbered, "objects": len(table),
        "moving": int(table["moving"].sum()),
        "numbers_twice": int(table["instance"].duplicated().sum()),
        "of_later_passes": int((table["instance"] >= PASS_INSTANCES).sum()),
        "numbers_without_a_row": int((~found["known"]).sum()),
        "rows_without_a_point": len(set(table["instance"]) - set(found.index)),
        "classes_without_a_number": sorted(TAXONOMY_NAMES[c] for c in gathered.without if c not in NUMBERLESS),
        "base_points_twice": int(table.loc[alone, ["x", "y"]].round(3).duplicated().sum()),
        "base_to_ground_max": float(np.abs(local[stands, 2] - ground).max()),
        "outside_box_share": float(steady["outside"].sum() / steady["points"].sum()),
        "far_outside_box_share": float(steady["far"].sum() / steady["points"].sum()),
        "objects_mostly_outside": int((steady["outside"] > 0.5 * steady["points"]).sum()),
        "seconds": time.perf_counter() - started,
    }  # fmt: skip
    for name, value in row.items():
        print(f"{name:26s}{value}")
    print(json.dumps(row))


if __name__ == "__main__":
    main()

"""Simulated scans beside recorded ones: beams, height, density and what lies above 2 m, as a table.

    python benchmarks/sensors.py [semantickitti images nuscenes ika pandaset] [--seeds 101 102]

Recordings are those of $MLSROAD_DATA/real. Each is compared with scans of its preset in two kinds of streets. Heights
are those above the lowest points within some metres.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from mlsroad_pipeline.simulation import PRESETS, SurveyPieces
from mlsroad_pipeline.simulation.parameters.street_parameters import STREETS
from mlsroad_pipeline.surveys.range_images import RangeImage

DATA = Path(os.environ.get("MLSROAD_DATA", Path(__file__).parents[2] / "shared/data")) / "real"
RANGES = (0.0, 10.0, 20.0, 40.0, 1e9)  # metres
NEAR = (10.0, 20.0, 30.0)  # metres; heights are given within 5 m of these
CELL = 4.0  # metres


@dataclass(frozen=True)
class Recording:
    """A recording, its preset, and the kinds of streets that it is compared with."""

    files: str
    preset: str
    kinds: tuple[str, str]
    revolutions: int = 1
    image: RangeImage | None = None
    scanner: tuple[float, float, float] = (0.0, 0.0, 0.0)


RECORDINGS = {
    "semantickitti": Recording("semantickitti_more/makeonebug/pcd/*.bin", "hdl64", ("residential", "old_town")),
    "images": Recording(
        "semantickitti_ika/train/*.npz", "hdl64", ("residential", "old_town"), image=RangeImage(rows=64, columns=1024)
    ),
    "nuscenes": Recording("nuscenes_lidarseg_ika/train/*.npz", "hdl32", ("downtown", "asian_arterial")),
    "ika": Recording("ika_vehicle_lidar/train/*.npz", "vlp32_front", ("rural", "residential")),
    "pandaset": Recording(
        "pandaset/001/frames/*.npz", "pandaset", ("downtown", "american_suburb"), scanner=(0.0, 0.0, 1.5)
    ),
}


def recorded(recording: Recording) -> Iterator[np.ndarray]:
    """Yield the points of each scan relative to its scanner."""
    for path in sorted(DATA.glob(recording.files)):
        if path.suffix == ".npz":
            with np.load(path, allow_pickle=False) as columns:
                xyz = columns["xyz"].astype(np.float64)
                xyz = xyz[columns["device"] == 0] if "device" in columns else xyz
        else:
            xyz = np.fromfile(path, "<f4").reshape(-1, 4)[:, :3].astype(np.float64)
        xyz = xyz - recording.scanner
        yield xyz[np.linalg.norm(xyz, axis=1) > 1.0]


def simulated(recording: Recording, seeds: list[int]) -> Iterator[np.ndarray]:
    """Yield the points of each simulated scan of the first device relative to its scanner, in the vehicle's axes."""
    for kind in recording.kinds:
        for seed in seeds:
            parameters = replace(
                PRESETS[recording.preset], seed=seed, street=STREETS[kind], length=48.0, speed=20.0, scan_spacing=12.0,
                revolutions=recording.revolutions,
            )  # fmt: skip
            pieces = SurveyPieces(parameters, n_threads=1)
            for cloud, _ in pieces:
                own = cloud.select(np.flatnonzero(cloud["scanner"] == 0))
                number, seconds = pieces.pass_of(own["gps_time"][[0, -1]])
                pose = pieces.sensor_pose(int(number[0]), float(seconds.mean()), parameters.devices[0])
                xyz = (own.xyz - pose[:3, 3]) @ pose[:3, :3]
                yield xyz if recording.image is None else xyz[recording.image.kept(xyz)]


def heights(xyz: np.ndarray) -> np.ndarray:
    """Return heights above the lowest of the points in the cells around each point."""
    column = np.floor(xyz[:, :2] / CELL).astype(np.int64)
    column -= column.min(axis=0) - 1
    lowest = np.full(column.max(axis=0) + 2, np.inf)
    np.minimum.at(lowest, (column[:, 0], column[:, 1]), xyz[:, 2])
    around = np.stack([np.roll(lowest, (i, j), (0, 1)) for i in (-1, 0, 1) for j in (-1, 0, 1)])
    return np.asarray(xyz[:, 2] - around.min(axis=0)[column[:, 0], column[:, 1]])


def describe(scans: Iterator[np.ndarray], beams: np.ndarray) -> dict[str, str]:
    """Describe scans of one kind; `beams` are the elevations of the preset, degrees."""
    rows: list[list[float]] = []
    for xyz in scans:
        distance = np.linalg.norm(xyz, axis=1)
        plan, height = np.hypot(xyz[:, 0], xyz[:, 1]), heights(xyz)
        elevation = np.degrees(np.arcsin(xyz[:, 2] / distance))
        off = np.abs(elevation[:, None] - beams).min(axis=1)
        azimuth = np.degrees(np.arctan2(xyz[:, 1], xyz[:, 0]))
        step = [np.diff(np.sort(azimuth[np.abs(elevation - beam) < 0.1])) for beam in beams]
        floor = xyz[(plan > 4) & (plan < 9) & (height < 0.3), 2]
        rows.append([
            len(xyz), -float(np.median(floor)) if len(floor) else np.nan,
            float(np.nanmedian(np.concatenate(step))), float((off < 0.12).mean()),
            *(float(((distance >= a) & (distance < b)).mean()) for a, b in pairwise(RANGES)),
            float((height > 2.0).mean()),
            *(float(np.quantile(height[np.abs(plan - r) < 5], 0.95)) for r in NEAR),
        ])  # fmt: skip
    mean = np.nanmean(rows, axis=0)
    return {
        "scans": str(len(rows)), "points": f"{mean[0]:,.0f}", "height, m": f"{mean[1]:.2f}",
        "step, degrees": f"{mean[2]:.2f}", "on beams": f"{mean[3]:.2f}",
        "within 10, 20, 40 m, beyond": ", ".join(f"{v:.2f}" for v in mean[4:8]), "above 2 m": f"{mean[8]:.2f}",
        "95 % height at 10, 20, 30 m": ", ".join(f"{v:.1f}" for v in mean[9:]),
    }  # fmt: skip


def main() -> None:
    """Print the table of the recordings that the command line names."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recordings", nargs="*", default=list(RECORDINGS), help=f"some of {', '.join(RECORDINGS)}")
    parser.add_argument("--seeds", type=int, nargs="+", default=[101, 102])
    options = parser.parse_args()
    for k, name in enumerate(options.recordings):
        if name not in RECORDINGS:
            parser.error(f"recording {name!r} is unknown (recordings: {', '.join(RECORDINGS)})")
        recording = RECORDINGS[name]
        beams = np.array(PRESETS[recording.preset].devices[0].elevations)
        for what, scans in (("recorded", recorded(recording)), ("simulated", simulated(recording, options.seeds))):
            row = describe(scans, beams)
            if k == 0 and what == "recorded":
                print("| " + " | ".join(["recording", "", *row]) + " |\n" + "|---" * (len(row) + 2) + "|")
            print("| " + " | ".join([f"`{name}`", what, *row.values()]) + " |", flush=True)


if __name__ == "__main__":
    main()

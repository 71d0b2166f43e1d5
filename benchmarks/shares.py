"""Shares of classes on simulated streets: ring roads beside luo2016's Table I, and towns.

    python benchmarks/shares.py

Prints two tables of percentages: of luo2016's seven classes, its class `other` left out, and of all classes of towns.
"""

from __future__ import annotations

import os
from dataclasses import replace

import numpy as np

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY, TAXONOMY_NAMES
from mlsroad_pipeline.simulation import PRESETS, simulate_survey
from mlsroad_pipeline.simulation.parameters.street_parameters import STREETS

LUO2016 = {
    "road": (66.6, ("road", "lane_marking", "parking", "manhole")), "grass": (20.9, ("grass",)),
    "palm tree": (6.0, ("palm",)), "cycas": (3.4, ("cycas",)), "brushwood": (2.3, ("brushwood",)),
    "light pole": (0.5, ("light_pole",)), "vehicle": (0.3, ("car", "van", "truck", "bus")),
}  # fmt: skip
LENGTH = 120.0


def counts(kind: str, seeds: range) -> tuple[np.ndarray, float]:
    """Return points per taxonomy code of some streets of a kind, and the share of hard cases among their objects."""
    total, hard, objects = np.zeros(256, np.int64), 0, 0
    for seed in seeds:
        parameters = replace(PRESETS["small"], seed=seed, length=LENGTH, street=STREETS[kind], with_images=False)
        survey = simulate_survey(parameters, n_threads=os.cpu_count() or 1)
        total += np.bincount(survey.cloud["label"], minlength=256)
        hard += int((survey.objects["hard_case"] != "").sum())
        objects += len(survey.objects)
    return total, hard / objects


def main() -> None:
    """Print the tables."""
    ring, hard = counts("ring_road", range(301, 304))
    found = {name: int(sum(ring[TAXONOMY[code]] for code in codes)) for name, (_, codes) in LUO2016.items()}
    print(f"three ring roads of {LENGTH:.0f} m, {100 * hard:.0f} % of the objects hard cases; luo2016, simulated")
    for name, count in found.items():
        print(f"{name:12s}{LUO2016[name][0]:6.1f}{100 * count / sum(found.values()):6.1f}")
    town, hard = counts("town", range(301, 307))
    print(f"six towns of {LENGTH:.0f} m, {100 * hard:.0f} % of the objects hard cases, {(town > 0).sum()} classes")
    for code in np.argsort(-town)[:24]:
        print(f"{TAXONOMY_NAMES[int(code)]:16s}{100 * town[code] / town.sum():6.2f}")


if __name__ == "__main__":
    main()

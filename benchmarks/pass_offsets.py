"""Offsets of planted shifts between two passes of simulated streets, and what is found where nothing was planted.

    python benchmarks/pass_offsets.py [--folder FOLDER] [--label 2]

Twenty streets of 80 m (preset `small`, two of each of ten kinds) are driven twice. The points of the second pass are
shifted in a random direction, raised and turned about their middle. The simulated trajectories of both passes drift by
some centimetres; errors are therefore counted from the offset of the undisturbed passes. `--label` also labels so many
streets undisturbed, shifted by (0.36, -0.36, 0.2) m, and aligned, and scores their inventories.

Prints a table in Markdown and writes `pass_offsets.json` into the folder.
"""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import laspy
import numpy as np
import pandas as pd
from _common import RESULTS, markdown, mlsroad, parser
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.registration.offset import Offset, find_offset
from mlsroad_pipeline.algorithms.registration.surfaces import turn_of
from mlsroad_pipeline.surveys.offset_warnings import disagrees

KINDS = (
    *("town", "suburb", "ring_road", "campus", "old_town", "downtown", "american_suburb", "residential", "industrial"),
    "rural",
)
PLANTED = ((0.05, 0.02, 0.0), (0.2, 0.1, 0.0), (0.5, 0.2, 0.2), (1.0, 3.0, 0.0), (2.0, 40.0, -0.2))
"""Shift in plan and in height, metres, and turn, degrees."""

SHIFT = np.array([0.36, -0.36, 0.2])
COLUMNS = ["plan", "height", "turn", "median error", "largest error", "largest in height", "right"]


def street_of(folder: Path, number: int) -> Path:
    """Return the folder of a street with two passes, simulated unless it is there."""
    kind = KINDS[(number - 1) // 2]
    street = folder / f"p{number:02d}_{kind}"
    if not (street / "objects.csv").is_file():
        changes = ("passes=2", "pass_offset=0", "piece_length=250", "with_images=false", f"street.kind={kind}")
        options = [word for change in changes for word in ("--params", change)]
        mlsroad("simulate", "-o", street, "--length", 80, "--seed", 60 + number, "--overwrite", *options)
    return street


def passes_of(street: Path) -> list[NDArray[np.float64]]:
    """Return the points of both passes, relative to the middle of the second."""
    first, second = (np.asarray(laspy.read(path).xyz) for path in sorted(street.glob("*.laz")))
    middle = second.mean(axis=0)
    return [first - middle, second - middle]


def errors(found: Offset | None, usual: Offset, planted: NDArray[np.float64]) -> tuple[float, float]:
    """Return the errors in plan and in height at the middle of the pass."""
    if found is None:
        return np.inf, np.inf
    moved = found.apply(planted[None])[0] - usual.apply(np.zeros((1, 3)))[0]
    return float(np.hypot(*moved[:2])), float(abs(moved[2]))


def offset_rows(streets: list[Path]) -> tuple[list[list[object]], int]:
    """Return a row per planted shift, and the number of undisturbed streets with an offset that counts."""
    rng = np.random.default_rng(0)
    found: dict[tuple[float, ...], list[tuple[float, float]]] = {planted: [] for planted in PLANTED}
    reported = 0
    for street in streets:
        first, second = passes_of(street)
        usual = find_offset(first, second)
        assert usual is not None, street
        reported += int(disagrees(usual))
        for planted in PLANTED:
            plan, height, turn = planted
            angle = rng.random() * 2 * np.pi
            shift = np.array([plan * np.cos(angle), plan * np.sin(angle), height])
            moved = second @ turn_of(np.radians(turn)).T + shift
            found[planted].append(errors(find_offset(first, moved), usual, shift))
    rows: list[list[object]] = []
    for (plan, height, turn), pairs in found.items():
        flat, up = np.array(pairs).T
        right = (flat <= max(0.03, 0.05 * plan)) & (up <= max(0.03, 0.05 * height))
        rows.append([plan, height, turn, *np.round([np.median(flat), flat.max(), up.max()], 3), int(right.sum())])
    return rows, reported


def inventory_rows(street: Path, folder: Path) -> list[list[object]]:
    """Return F of the inventory of a street undisturbed, shifted and aligned."""
    shifted = folder / f"{street.name}_shifted"
    shutil.copytree(street, shifted, dirs_exist_ok=True)
    path = sorted(shifted.glob("*.laz"))[1]
    las = laspy.read(path)
    las.xyz = np.asarray(las.xyz) + SHIFT
    las.write(path)
    rows: list[list[object]] = []
    align = ("--params", "label.align_passes=true")
    for name, survey, more in (("undisturbed", street, ()), ("shifted", shifted, ()), ("aligned", shifted, align)):
        results = folder / f"{street.name}_{name}_mlsroad"
        mlsroad("label", survey, "-o", results, *more)
        mlsroad("score", results, "--truth", street, "--overwrite")
        scores = pd.read_csv(results / "scores/object_scores.csv").set_index("kind")
        rows.append([street.name, name, f"{scores.loc['all', 'f_score']:.3f}"])
    return rows


def main() -> None:
    """Simulate, shift, measure, print."""
    arguments = parser(__doc__)
    arguments.add_argument("--folder", type=Path, default=RESULTS / "pass_offsets")
    arguments.add_argument("--label", type=int, default=0)
    given = arguments.parse_args()
    folder = given.folder.absolute()
    folder.mkdir(parents=True, exist_ok=True)
    streets = [street_of(folder, number) for number in range(1, 2 * len(KINDS) + 1)]
    rows, reported = offset_rows(streets)
    print(markdown(pd.DataFrame(rows, columns=COLUMNS)))
    print(f"Undisturbed streets with an offset that counts: {reported} of {len(streets)}")
    scored = [row for street in streets[: given.label] for row in inventory_rows(street, folder)]
    print(markdown(pd.DataFrame(scored, columns=["street", "passes", "F"])))
    record = {"rows": rows, "undisturbed": reported, "inventories": scored}
    (folder / "pass_offsets.json").write_text(json.dumps(record, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()

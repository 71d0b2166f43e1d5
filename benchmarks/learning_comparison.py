"""Verdict of `mlsroad learn` beside the reference: better, worse or no difference, on recordings.

    kedro run --env=recordings
    python benchmarks/learning_comparison.py [--folder FOLDER] [--answers 30] [--wrong 0.0] [--sources NAME...]

Takes the surveys of `places.py`. A simulated user paints the first places of the page that can be judged (at least 100
points within 40 m, 80 % of one common class); a share of `--wrong` gets another class. The reference says better or
worse where the mean IoU of the points without an answer changes by more than 0.005.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import yaml
from _common import CONF, REPOSITORY, RESULTS, parser
from numpy.typing import NDArray
from places import COMMON, FINE, PURE, SCENES, User, prepare

from mlsroad_pipeline.algorithms.inventory.objects.doubts import FARTHEST, LEAST_POINTS
from mlsroad_pipeline.algorithms.metrics.confusion import confusion_matrix, scores
from mlsroad_pipeline.execution.store import SceneStore
from mlsroad_pipeline.papers.comparison.recordings.parameters import sources_of
from mlsroad_pipeline.papers.comparison.recordings.scoring import unmixed
from mlsroad_pipeline.review.corrections import Correction, open_corrections

TELLS, SEED = 0.005, 58
VERDICT = re.compile(r"Comparison: (better|worse|no difference), because (.*?)\.\s*$", re.DOTALL)


def answers(user: User, number: int) -> list[tuple[NDArray[np.int64], int]]:
    """Return the points and the true common class of the first places that can be judged."""
    found: dict[tuple[int, int], tuple[NDArray[np.int64], int]] = {}
    groups = user.groups
    for segment in groups.order(4 * number):
        place, code = groups._sample.xyz[groups._places[segment]].astype(np.float64), int(groups._codes[segment])
        rows = groups.points(place, code).rows.astype(np.int64)
        known = user.truth[rows][user.truth[rows] >= 0]
        if len(rows) < LEAST_POINTS or groups._facts[3][segment] > FARTHEST or 2 * len(known) < len(rows):
            continue
        counts = np.bincount(known, minlength=len(COMMON))
        if counts.max() >= PURE * len(known):
            found.setdefault((code, int(rows[0])), (rows, int(counts.argmax())))
        if len(found) == number:
            break
    return list(found.values())


def mean_iou(user: User, labelled: Path, skip: NDArray[np.bool_]) -> float:
    """Return the mean IoU of the common classes of a recording, of points that no answer is about."""
    of_code = np.full(256, -1)
    for code, name in user.names.items():
        if name in FINE.classes:
            of_code[code] = FINE.coarsen(COMMON)[FINE.classes.index(name)]
    label = of_code[np.asarray(laspy.read(labelled).classification)]
    used = (user.truth >= 0) & ~skip
    truth = user.truth[used]
    label = unmixed(truth, label[used], COMMON, user.source.mixed)
    matrix = confusion_matrix(truth, label, len(COMMON))
    iou = scores(matrix).iou
    kept = [COMMON.classes.index(name) for name in user.source.classes if name != "other"]
    return float(np.mean([iou[c] for c in kept if matrix[c].sum() >= LEAST_POINTS]))


def compared(user: User, folder: Path, number: int, wrong: float) -> dict[str, Any]:
    """Answer, learn, and return the verdict and the mean IoU before and after."""
    out, rng = folder / "learned", np.random.default_rng(SEED)
    shutil.rmtree(out, ignore_errors=True)
    shutil.copytree(folder / "out", out)
    skip, made = np.zeros(len(user.truth), bool), []
    for rows, true in answers(user, number):
        others = [c for c in range(len(COMMON)) if c != true and COMMON.classes[c] in user.source.classes]
        given = COMMON.classes[int(rng.choice(others)) if rng.random() < wrong else true]
        payload = {"file": "survey.laz", "points": rows.tolist(), "class": given, "n_points": len(user.truth)}
        made.append(Correction("paint", payload=payload))
        skip[rows] = True
    with open_corrections(out) as store:
        store.add_all(made, who="script")
    before = mean_iou(user, out / "survey.laz", skip)
    code = "import sys; sys.argv[0] = 'mlsroad'; from mlsroad_pipeline.commands.app import main; main()"
    done = subprocess.run(
        [sys.executable, "-c", code, "learn", str(out), "--accept", "--workers", "1"],
        capture_output=True, text=True, check=False, cwd=folder,
    )  # fmt: skip
    said = VERDICT.search(done.stdout)
    if done.returncode or said is None:
        raise SystemExit(f"mlsroad learn {out}: {done.stderr.strip()}")
    after = mean_iou(user, out / "survey.laz", skip)
    change = after - before
    truth = "better" if change > TELLS else "worse" if change < -TELLS else "no difference"
    found = {"answers": len(made), "before": round(before, 4), "after": round(after, 4), "reference": truth}
    return found | {"verdict": said[1], "because": " ".join(said[2].split())}


def main() -> None:
    """Compare each recording."""
    arguments = parser(__doc__)
    arguments.add_argument("--folder", type=Path, default=RESULTS / "places")
    arguments.add_argument("--answers", type=int, default=30)
    arguments.add_argument("--wrong", type=float, default=0.0)
    arguments.add_argument("--sources", nargs="*")
    given = arguments.parse_args()
    config = yaml.safe_load((CONF / "recordings/parameters.yml").read_text(encoding="utf-8"))["recordings_study"]
    store = SceneStore(str(REPOSITORY / SCENES))
    for name, source in sources_of(config["sources"]).items():
        if given.sources is None or name in given.sources:
            if not (given.folder / name / "out/inventory.gpkg").is_file():
                prepare(source, store, given.folder / name)
            user = User(source, given.folder / name)
            print(source.title, compared(user, given.folder / name, given.answers, given.wrong), flush=True)


if __name__ == "__main__":
    main()

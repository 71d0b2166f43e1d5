"""Speed of pictures and of the confusion matrix, beside scikit-learn; clouds are found through $MLSROAD_RIVALS."""

import json
import os
import statistics
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from sklearn.metrics import confusion_matrix as sklearn_matrix

from mlsroad_pipeline.algorithms.metrics.confusion import confusion_matrix
from mlsroad_pipeline.reporting.clouds.splatting import nearest_points, render_points
from mlsroad_pipeline.reporting.clouds.view import birds_eye_view, oblique_view


def race(work: dict[str, Callable[[], object]], *, repeats: int = 5) -> dict[str, float]:
    """Return the median seconds of each piece of work, run in turn after one round that is not counted."""
    seconds: dict[str, list[float]] = {name: [] for name in work}
    for k in range(repeats + 1):
        for name, function in work.items():
            start = time.perf_counter()
            function()
            if k:
                seconds[name].append(time.perf_counter() - start)
    return {name: statistics.median(values) for name, values in seconds.items()}


def main() -> None:
    """Print a table and JSON lines."""
    rng = np.random.default_rng(0)
    truth = rng.integers(0, 10, 5_000_000).astype(np.int16)
    predicted = np.where(rng.random(len(truth)) < 0.9, truth, 0).astype(np.int16)
    work: dict[str, tuple[int, Callable[[], object]]] = {
        "confusion matrix": (len(truth), lambda: confusion_matrix(truth, predicted, 10)),
        "confusion matrix, scikit-learn": (len(truth), lambda: sklearn_matrix(truth, predicted)),
    }
    cloud = Path(os.environ.get("MLSROAD_RIVALS", "rivals_data")) / "street_5M.npz"
    if cloud.exists():
        with np.load(cloud) as stored:
            xyz, rgb = stored["xyz"], stored["rgb"]
        for name, view in (("plan", birds_eye_view(xyz)), ("perspective", oblique_view(xyz))):
            large = view.enlarged(2)
            work[f"splats, {name}"] = (len(xyz), lambda large=large: nearest_points(xyz, large))
            work[f"picture, {name}"] = (len(xyz), lambda view=view: render_points(xyz, rgb, view))
    else:
        print(f"no {cloud}: pictures are left out")
    medians = race({name: function for name, (_, function) in work.items()})
    for name, seconds in medians.items():
        print(f"{name:32s} {seconds:8.3f} s {work[name][0] / seconds / 1e6:8.1f} M points/s")
        kernel, _, rival = name.partition(", scikit")
        row = {"kernel": kernel, "program": "scikit-learn" if rival else "mlsroad"}
        print(json.dumps({**row, "points": work[name][0], "seconds": round(seconds, 4)}))


if __name__ == "__main__":
    main()

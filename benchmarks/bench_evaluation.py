"""Speed of pictures and of the confusion matrix, compared with scikit-learn.

MLSROAD_RIVALS=rivals_data python benchmarks/bench_evaluation.py
"""

import numpy as np
from _common import RIVALS, cloud_arrays, parser, race, show
from sklearn.metrics import confusion_matrix as sklearn_matrix

from mlsroad_pipeline.algorithms.metrics.confusion import confusion_matrix
from mlsroad_pipeline.reporting.clouds.splatting import nearest_points, render_points
from mlsroad_pipeline.reporting.clouds.view import birds_eye_view, oblique_view


def main() -> None:
    """Run all races."""
    parser(__doc__).parse_args()
    rng = np.random.default_rng(0)
    truth = rng.integers(0, 10, 5_000_000).astype(np.int16)
    predicted = np.where(rng.random(len(truth)) < 0.9, truth, 0).astype(np.int16)
    matrices = {
        "mlsroad": lambda: confusion_matrix(truth, predicted, 10),
        "scikit-learn": lambda: sklearn_matrix(truth, predicted),
    }
    show("confusion matrix", len(truth), race(matrices, repeats=5, warm_up=1))
    if not (RIVALS / "street_5M.npz").exists():
        print(f"not found: {RIVALS / 'street_5M.npz'}; pictures are left out")
        return
    cloud = cloud_arrays("street_5M")
    xyz, rgb = cloud["xyz"], cloud["rgb"]
    for name, view in (("plan", birds_eye_view(xyz)), ("perspective", oblique_view(xyz))):
        works = {
            f"splats, {name}": lambda view=view: nearest_points(xyz, view.enlarged(2)),
            f"picture, {name}": lambda view=view: render_points(xyz, rgb, view),
        }
        for kernel, found in race(works, repeats=5, warm_up=1).items():
            show(kernel, len(xyz), {"mlsroad": found})


if __name__ == "__main__":
    main()

"""Speed of clustering, trajectory coordinates, inventory, scores and pictures beside PCL, SciPy and scikit-learn.

    MLSROAD_RIVALS=rivals_data python benchmarks/bench_clusters.py [1M 5M ...]

`$MLSROAD_RIVALS` is a folder with PCL's programs in `build/` and clouds `street_{1M,5M,20M}.npz` and `..._off.npz`;
SciPy and scikit-learn are those of this environment. Runs alternate, medians are printed, compilation is not timed.
"""

from collections.abc import Callable
from functools import partial

import numpy as np
from _common import RIVALS, cloud_arrays, parser, pcl_programs, race, run_pcl, show
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree
from sklearn.metrics import confusion_matrix as sklearn_matrix

from mlsroad_pipeline.algorithms.inventory.objects.extraction import extract_objects
from mlsroad_pipeline.algorithms.inventory.objects.merging import merge_across_scenes
from mlsroad_pipeline.algorithms.inventory.objects.rules import ObjectRule
from mlsroad_pipeline.algorithms.metrics.confusion import confusion_matrix
from mlsroad_pipeline.algorithms.scenes.trajectory import Trajectory
from mlsroad_pipeline.algorithms.segmentation.euclidean import cluster
from mlsroad_pipeline.reporting.clouds.splatting import nearest_points, render_points
from mlsroad_pipeline.reporting.clouds.view import birds_eye_view, oblique_view

TOLERANCE = 0.15
REPEATS = 3
SCIPY_UP_TO = 1_000_000  # points: beyond it the pairs fill the memory
PCL_UP_TO = 3_000_000  # points: beyond it a run takes minutes


def scipy_components(xyz: np.ndarray) -> np.ndarray:
    pairs = cKDTree(xyz).query_pairs(TOLERANCE, output_type="ndarray")
    graph = coo_array((np.ones(len(pairs), np.int8), (pairs[:, 0], pairs[:, 1])), shape=(len(xyz), len(xyz)))
    return connected_components(graph, directed=False)[1]


def cluster_race(size: str) -> None:
    xyz = cloud_arrays(f"street_{size}_off")["xyz"]
    works: dict[str, Callable[[], object]] = {"mlsroad": lambda: cluster(xyz, tolerance=TOLERANCE)}
    if len(xyz) <= PCL_UP_TO:
        cloud = RIVALS / f"street_{size}_off.pcd"
        for name, program in pcl_programs().items():
            works[name] = partial(run_pcl, program, "cluster", cloud, tol=TOLERANCE)
    if len(xyz) <= SCIPY_UP_TO:
        works["SciPy components"] = lambda: scipy_components(xyz)
    show(f"clusters {TOLERANCE} m", len(xyz), race(works, repeats=REPEATS))


def locate_race(n_points: int = 1_000_000) -> None:
    rng = np.random.default_rng(0)
    s = np.linspace(0, 2000, 20_001)
    path = Trajectory.from_positions(np.column_stack([s, 60 * np.sin(s / 150), 0 * s]))
    along = np.sort(rng.uniform(0, 2000, n_points))
    xyz = np.column_stack([along, 60 * np.sin(along / 150) + rng.uniform(-20, 20, n_points), 0 * along])
    tree = cKDTree(path.xyz[:, :2])
    works = {"mlsroad": lambda: path.locate(xyz), "SciPy cKDTree, nearest vertex only": lambda: tree.query(xyz[:, :2])}
    show("station and offset", n_points, race(works, repeats=REPEATS, warm_up=1))


def inventory_race(size: str) -> None:
    cloud = cloud_arrays(f"street_{size}")
    xyz, label = cloud["xyz"], cloud["cls"]
    kinds = {"pole": 6, "sign": 7, "vehicle": 8, "tree": 9}
    rules = {kind: ObjectRule.of_kind(kind, code) for kind, code in kinds.items()}
    sure = np.ones(len(xyz))

    def run() -> object:
        return merge_across_scenes([extract_objects(xyz, label, sure, classes=rules)], classes=rules)

    show("inventory", len(xyz), race({"mlsroad": run}, repeats=REPEATS))


def matrix_race() -> None:
    rng = np.random.default_rng(0)
    truth = rng.integers(0, 10, 5_000_000).astype(np.int16)
    predicted = np.where(rng.random(len(truth)) < 0.9, truth, 0).astype(np.int16)
    works = {
        "mlsroad": lambda: confusion_matrix(truth, predicted, 10),
        "scikit-learn": lambda: sklearn_matrix(truth, predicted),
    }
    show("confusion matrix", len(truth), race(works, repeats=5, warm_up=1))


def picture_race(size: str) -> None:
    cloud = cloud_arrays(f"street_{size}")
    xyz, rgb = cloud["xyz"], cloud["rgb"]
    for name, view in (("plan", birds_eye_view(xyz)), ("perspective", oblique_view(xyz))):
        works = {
            f"splats, {name}": lambda view=view: nearest_points(xyz, view.enlarged(2)),
            f"picture, {name}": lambda view=view: render_points(xyz, rgb, view),
        }
        for kernel, found in race(works, repeats=5, warm_up=1).items():
            show(kernel, len(xyz), {"mlsroad": found})


def main() -> None:
    """Run all races."""
    arguments = parser(__doc__)
    arguments.add_argument("sizes", nargs="*", default=["1M", "5M"])
    sizes = arguments.parse_args().sizes
    for dtype in (np.float32, np.float64):
        cluster(np.random.default_rng(0).random((200, 3)).astype(dtype), tolerance=0.1)  # compiles
    locate_race()
    matrix_race()
    for size in sizes:
        cluster_race(size)
        inventory_race(size)
    picture_race(sizes[-1])


if __name__ == "__main__":
    main()

"""Scores of the detrended forest, with and without detrending, or of a shipped model on unseen simulated streets.

    python benchmarks/simulated_streets.py [--seeds 21 22 23] [--forest-seeds 2019] [--kind town]
    python benchmarks/simulated_streets.py --cross-validate
    python benchmarks/simulated_streets.py --seeds 51 52 53 --model pool

The first trains on the streets `train*` of conf/base/parameters_simulation.yml and labels its street `test`, simulated
with each of the seeds. The second leaves one training street out at a time and labels it; parameters are chosen by it.
Both use the features of conf/base with and without their detrended part, with the same seeds. The third labels the
streets with a model of the package, without training. A street is one scene; `kedro run` cuts it into scenes of 30 m
with buffers. Prints the F1 of each class of tomic2019 per street, and mean and standard deviation over the streets.
"""

from __future__ import annotations

import os
from typing import Any

import numpy as np
from _common import configured, configured_scheme, configured_stages, parser, prepare, report

from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.metrics.confusion import confusion_matrix, scores
from mlsroad_pipeline.algorithms.models.bundle import bundle_scheme
from mlsroad_pipeline.algorithms.models.labelling import label_cloud
from mlsroad_pipeline.model_store.shipped_models import load_shipped
from mlsroad_pipeline.papers.shared.evaluation import coarse_labels
from mlsroad_pipeline.papers.tomic2019.detrended_forest.labeller import label_scene
from mlsroad_pipeline.papers.tomic2019.detrended_forest.training import ForestParameters, fit, training_rows
from mlsroad_pipeline.simulation import simulate_survey
from mlsroad_pipeline.simulation.parameters.presets import simulation_parameters

N_JOBS = os.cpu_count() or 1


def simulate(name: str, seed: int | None = None, kind: str | None = None) -> PointCloud:
    """Simulate a street of the configuration, or another one of its kind or of a given one."""
    config = dict(configured("simulation")["surveys"][name])
    config |= {} if seed is None else {"seed": seed}
    config |= {} if kind is None else {"street": kind}
    return simulate_survey(simulation_parameters(config), n_threads=N_JOBS).cloud


class Trial:
    """A variant of the comparison: the detrended forest with or without detrended features."""

    def __init__(self, name: str, *, detrend: bool) -> None:
        self.name, self.stages = name, configured_stages(detrend=detrend)
        survey = configured("survey")
        self.scheme, self.scored = (configured_scheme(survey[key]) for key in ("scheme", "evaluation_scheme"))
        self.found: list[np.ndarray] = []

    def rows(self, cloud: PointCloud) -> dict[str, Any]:
        """Return a street's labelled supervoxels."""
        return training_rows(**prepare(cloud, self.stages), scheme=self.scheme)

    def train(self, rows: list[dict[str, Any]], seed: int) -> Any:
        """Train a forest."""
        forest = ForestParameters(**{**configured("detrended_forest"), "seed": seed})
        options: dict[str, Any] = {"trained_on": {}, "n_jobs": N_JOBS, "fallbacks": False}
        bundle, _ = fit(rows, parameters=forest, stages=self.stages, scheme=self.scheme, **options)
        return bundle

    def label(self, name: str, bundle: Any, cloud: PointCloud, seed: int) -> None:
        """Label a street and print the scores."""
        self.score(name, cloud, label_scene(**prepare(cloud, self.stages), bundle=bundle)["label"], seed)

    def score(self, name: str, cloud: PointCloud, predicted: np.ndarray, seed: int) -> None:
        """Print the scores of labels."""
        truth = self.scored.encode(cloud["label"], source=name)
        found = coarse_labels(predicted, self.scheme, self.scored)
        matrix = confusion_matrix(truth, found, len(self.scored))
        report(f"{self.name} {name}", seed, matrix, self.scored)
        self.found.append(matrix)

    def summary(self) -> None:
        """Print the means over all streets."""
        rows = [scores(matrix) for matrix in self.found]
        for figure in ("overall_accuracy", "mean_f1"):
            values = np.array([getattr(row, figure) for row in rows])
            spread = values.std(ddof=1) if len(values) > 1 else float("nan")
            print(f"{self.name}: {figure} {values.mean():.4f} +- {spread:.4f} over {len(values)} streets")
        report(f"{self.name} all", 0, np.sum(self.found, axis=0), self.scored)


class Shipped(Trial):
    """Scores of a model of the package; its training streets have other seeds."""

    def __init__(self, name: str) -> None:
        super().__init__(name, detrend=False)
        self.bundle = load_shipped(name)
        self.scheme = bundle_scheme(self.bundle)

    def label_with(self, name: str, cloud: PointCloud) -> None:
        """Label a street and print the scores."""
        unknown = cloud.without_columns([c for c in ("label", "instance") if c in cloud])
        self.score(name, cloud, label_cloud(self.bundle, unknown)[0], 0)


def main() -> None:
    """Run what the command line asks for."""
    arguments = parser(__doc__)
    arguments.add_argument("--seeds", type=int, nargs="+", default=[21, 22, 23], help="seeds of the streets to label")
    arguments.add_argument("--forest-seeds", type=int, nargs="+", default=[configured("detrended_forest")["seed"]])
    arguments.add_argument("--kind", help="kind of the streets to label, such as town, in place of the test street's")
    arguments.add_argument("--cross-validate", action="store_true", help="leave one training street out at a time")
    arguments.add_argument("--model", help="a model of the package, such as pool, in place of training")
    options = arguments.parse_args()
    if options.model:
        shipped = Shipped(options.model)
        for seed in options.seeds:
            street = simulate("test", seed, options.kind)
            shipped.label_with(f"street {seed}", street)
        shipped.summary()
        return
    names = [name for name in configured("simulation")["surveys"] if name.startswith("train")]
    streets = {name: simulate(name) for name in names}
    tests = dict(streets)
    if not options.cross_validate:
        tests = {f"street {seed}": simulate("test", seed, options.kind) for seed in options.seeds}
    for trial in (Trial("detrended", detrend=True), Trial("plain", detrend=False)):
        rows = {name: trial.rows(cloud) for name, cloud in streets.items()}
        for seed in options.forest_seeds:
            bundle = None if options.cross_validate else trial.train(list(rows.values()), seed)
            for name, cloud in tests.items():
                model = bundle or trial.train([row for other, row in rows.items() if other != name], seed)
                trial.label(name, model, cloud, seed)
        trial.summary()


if __name__ == "__main__":
    main()

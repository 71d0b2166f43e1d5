"""Scores of the detrended forest on unseen simulated streets, with and without detrending.

    python benchmarks/simulated_streets.py [--seeds 21 22 23] [--forest-seeds 2019] [--kind town]
    python benchmarks/simulated_streets.py --cross-validate
    python benchmarks/simulated_streets.py --seeds 21 --picture NEW.jpg
    python benchmarks/simulated_streets.py --seeds 51 52 53 --model pool

The first trains on the streets `train*` of conf/base/parameters_simulation.yml and labels its street `test` drawn with
each of the seeds. The second leaves one training street out at a time and labels it: parameters are chosen by it,
without a look at the test street. Both are done with the features of conf/base and without their detrended part, with
the same seeds. The last labels the streets with a model of the package, without training. A street is one scene; `kedro
run` cuts it into scenes of 30 m with buffers. Prints a table with the F1 of each class of tomic2019, a JSON line per
row, and the mean over the streets with its standard deviation.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path
from typing import Any

import numpy as np
from forest_trials import configured, configured_scheme, configured_stages, prepare, report
from PIL import Image

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.metrics.confusion import confusion_matrix, scores
from mlsroad_pipeline.algorithms.models.bundle import bundle_scheme
from mlsroad_pipeline.algorithms.models.labelling import label_cloud
from mlsroad_pipeline.model_store.shipped_models import load_shipped
from mlsroad_pipeline.papers.shared.evaluation.labelling import coarse_labels
from mlsroad_pipeline.papers.tomic2019.detrended_forest.labeller import label_scene
from mlsroad_pipeline.papers.tomic2019.detrended_forest.training import ForestParameters, fit, training_rows
from mlsroad_pipeline.reporting.clouds.cloud_figures import cloud_figure, labelling_pictures
from mlsroad_pipeline.reporting.clouds.view import oblique_view
from mlsroad_pipeline.reporting.html.parts import figure_pixels
from mlsroad_pipeline.simulation import simulate_survey
from mlsroad_pipeline.simulation.parameters.presets import simulation_parameters

PICTURE_WIDTH = 1100  # pixels
N_JOBS = os.cpu_count() or 1


def simulate(name: str, seed: int | None = None, kind: str | None = None) -> PointCloud:
    """Simulate a street of the configuration, or another one of its kind or of a given one."""
    config = dict(configured("simulation")["surveys"][name])
    config |= {} if seed is None else {"seed": seed}
    config |= {} if kind is None else {"street": kind}
    return simulate_survey(simulation_parameters(config), n_threads=N_JOBS).cloud


class Trial:
    """One arm of the comparison: how scenes are prepared, and what a forest makes of them.

    Parameters
    ----------
    name : str
        What rows call it.
    detrend : bool
        Whether the features have their detrended part.
    """

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

    def label(self, name: str, bundle: Any, cloud: PointCloud, seed: int) -> tuple[np.ndarray, np.ndarray]:
        """Label a street, print the scores and return truth and prediction."""
        truth = self.scored.encode(cloud["label"], source=name)
        return self.score(name, truth, label_scene(**prepare(cloud, self.stages), bundle=bundle)["label"], seed)

    def score(self, name: str, truth: np.ndarray, predicted: np.ndarray, seed: int) -> tuple[np.ndarray, np.ndarray]:
        """Print the scores of labels and return truth and prediction."""
        found = coarse_labels(predicted, self.scheme, self.scored)
        matrix = confusion_matrix(truth, found, len(self.scored))
        report(f"{self.name} {name}", seed, matrix, self.scored)
        self.found.append(matrix)
        return truth, found

    def summary(self) -> None:
        """Print the means over all streets."""
        rows = [scores(matrix) for matrix in self.found]
        for figure in ("overall_accuracy", "mean_f1"):
            values = np.array([getattr(row, figure) for row in rows])
            spread = values.std(ddof=1) if len(values) > 1 else float("nan")
            print(f"{self.name}: {figure} {values.mean():.4f} +- {spread:.4f} over {len(values)} streets")
        report(f"{self.name} all", 0, np.sum(self.found, axis=0), self.scored)


class Shipped(Trial):
    """Scores of a model of the package; its training streets have other seeds.

    Parameters
    ----------
    name : str
        The model.
    """

    def __init__(self, name: str) -> None:
        super().__init__(name, detrend=False)
        self.bundle = load_shipped(name)
        self.scheme = bundle_scheme(self.bundle)

    def label_with(self, name: str, cloud: PointCloud) -> tuple[np.ndarray, np.ndarray]:
        """Label a street, print the scores and return truth and prediction."""
        truth = self.scored.encode(cloud["label"], source=name)
        unknown = cloud.without_columns([c for c in ("label", "instance") if c in cloud])
        return self.score(name, truth, label_cloud(self.bundle, unknown)[0], 0)


def draw(path: Path, cloud: PointCloud, truth: np.ndarray, predicted: np.ndarray, scheme: ClassScheme) -> None:
    """Paint truth and prediction from above the street."""
    xyz = np.asarray(cloud.xyz, dtype=np.float64)
    view = oblique_view(xyz, size=(1600, 900))
    pictures = labelling_pictures(xyz, view, classes=scheme, truth=truth, predicted=predicted)
    panels = {name: pictures[name] for name in ("truth", "prediction")}
    figure = cloud_figure(panels, view, classes=scheme, present=np.unique(truth))
    picture = Image.fromarray(figure_pixels(figure))
    size = (PICTURE_WIDTH, round(picture.height * PICTURE_WIDTH / picture.width))
    picture.resize(size, Image.Resampling.LANCZOS).save(path, quality=85)


def main() -> None:
    """Run what the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, nargs="+", default=[21, 22, 23], help="seeds of the streets to label")
    parser.add_argument("--forest-seeds", type=int, nargs="+", default=[configured("detrended_forest")["seed"]])
    parser.add_argument("--kind", help="kind of the streets to label, such as town, in place of the test street's")
    parser.add_argument("--cross-validate", action="store_true", help="leave one training street out at a time")
    parser.add_argument("--model", help="a model of the package, such as pool, in place of training")
    parser.add_argument("--picture", type=Path, help="where to paint the first street that is labelled")
    options = parser.parse_args()
    if options.model:
        shipped = Shipped(options.model)
        for seed in options.seeds:
            street = simulate("test", seed, options.kind)
            truth, found = shipped.label_with(f"street {seed}", street)
            if options.picture and not options.picture.exists():
                draw(options.picture, street, truth, found, shipped.scored)
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
                truth, found = trial.label(name, model, cloud, seed)
                if options.picture and not options.picture.exists():
                    draw(options.picture, cloud, truth, found, trial.scored)
        trial.summary()


if __name__ == "__main__":
    main()

"""From simulated streets to recordings: how well a forest that never saw a recording labels one.

    python benchmarks/transfer.py oakland [--seeds 101 102 ...] [--length 120] [--surveys FOLDER] [--without-real]
    python benchmarks/transfer.py semantickitti [--kind suburb] [...]

Trains `detrended_forest` on streets that are simulated with the scanner of the recording (presets ``oakland`` and
``hdl64``), scores it on the recording below $MLSROAD_DATA, and beside it a forest that was trained on the recording's
own training split (conf/oakland, conf/semantickitti) and is scored on its test split. `--surveys` trains on the LAZ
files below a folder, as `kedro run --pipelines=simulate` writes them, instead. Parameters are those of conf/base and of
the recording's environment. Prints a table with confusion matrices, and one JSON line per row.
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
from dataclasses import replace
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.core.codings import Coding
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.stage_parameters import (
    FeatureParameters,
    GroundParameters,
    StageParameters,
    SupervoxelParameters,
)
from mlsroad_pipeline.algorithms.metrics.confusion import confusion_matrix, scores
from mlsroad_pipeline.algorithms.stages import build_supervoxels, describe_supervoxels, find_ground
from mlsroad_pipeline.formats.options import ReadOptions
from mlsroad_pipeline.formats.registry import get_format
from mlsroad_pipeline.papers.tomic2019.detrended_forest.labeller import label_scene
from mlsroad_pipeline.papers.tomic2019.detrended_forest.training import ForestParameters, fit, training_rows
from mlsroad_pipeline.simulation import PRESETS, SimulationParameters, simulate_survey
from mlsroad_pipeline.simulation.parameters.street_parameters import STREETS
from mlsroad_pipeline.simulation.runtime.survey import SurveyPieces
from mlsroad_pipeline.surveys.simulated_frames import FrameWriter

CONF = Path(__file__).resolve().parents[1] / "conf"
PRESET = {"oakland": "oakland", "semantickitti": "hdl64"}
LENGTH = {"oakland": 120.0, "semantickitti": 60.0}
FRAME_STEP = 20  # revolutions from one frame that is used to the next


def configured(group: str, environment: str) -> dict[str, Any]:
    """Return a group of parameters as an environment has it."""
    base = yaml.safe_load((CONF / f"base/parameters_{group}.yml").read_text(encoding="utf-8"))[group]
    own = yaml.safe_load((CONF / f"{environment}/parameters.yml").read_text(encoding="utf-8")).get(group, {})
    return {**base, **own}


class Recording:
    """A recording, how its environment reads it, and the stages before the forest.

    Parameters
    ----------
    name : {"oakland", "semantickitti"}
        Name of the environment and of the folder below $MLSROAD_DATA.
    """

    def __init__(self, name: str) -> None:
        self.name, self.survey, classes = name, configured("survey", name), configured("classes", name)
        self.scheme = ClassScheme.from_config(self.survey["scheme"], classes["schemes"][self.survey["scheme"]])
        self.coding = Coding(name, classes["codings"][self.survey["coding"]])
        self.root = Path(os.environ.get("MLSROAD_DATA", CONF.parents[1] / "shared/data")) / name
        self.stages = StageParameters(
            GroundParameters(**configured("ground_removal", name)),
            SupervoxelParameters(**configured("supervoxelise", name)),
            FeatureParameters(**configured("features", name)),
        )
        self.forest = ForestParameters(**configured("detrended_forest", name))

    def read(self, path: Path) -> PointCloud:
        """Read a file of the recording, or one written as such."""
        return get_format(path).read(path, ReadOptions.from_config({**self.survey["read"], "coding": self.coding}))

    def scenes(self) -> dict[str, tuple[PointCloud, str]]:
        """Return the recording's scenes with the split that each belongs to; a point between splits to none."""
        out = {}
        for split, spec in self.survey["splits"].items():
            patterns = spec if isinstance(spec, str) else spec["files"][0]
            for path in sorted(p for p in self.root.iterdir() if fnmatch(p.name, patterns)):
                cloud = self.read(path)
                if not isinstance(spec, str):
                    cloud = cloud.select(_in_sectors(cloud, spec["sectors"], spec["gap"]))
                out[f"{path.name} {split}"] = (cloud, split)
        return out

    def prepare(self, cloud: PointCloud) -> dict[str, Any]:
        """Run the stages before the forest."""
        ground = find_ground(cloud, self.stages.ground)
        supervoxels = build_supervoxels(cloud, self.stages.supervoxels)
        features = describe_supervoxels(cloud, ground, supervoxels, self.stages.features)
        return {"scene": cloud, "supervoxels": supervoxels, "features": features}

    def simulate(self, parameters: SimulationParameters) -> list[PointCloud]:
        """Simulate a street as this recording would show it."""
        if self.name == "oakland":
            cloud = simulate_survey(parameters, n_threads=os.cpu_count() or 1).cloud
            return [PointCloud(cloud.xyz, {"label": cloud["label"]}, source=f"street {parameters.seed}")]
        with tempfile.TemporaryDirectory() as folder:
            write_frames(Path(folder), parameters)
            files = sorted(Path(folder).rglob("*.bin"))[5::FRAME_STEP]
            return [self.read(path) for path in files]


def write_frames(folder: Path, parameters: SimulationParameters) -> None:
    """Write a simulated drive as KITTI scans, labels beside the points."""
    pieces = SurveyPieces(parameters, n_threads=os.cpu_count() or 1)
    writer = FrameWriter(folder, parameters, pieces)
    for cloud, _ in pieces:
        writer.write(cloud)
    writer.close()
    for labels in list(folder.rglob("*.label")):
        labels.rename(folder / "velodyne" / labels.name)


def _in_sectors(cloud: PointCloud, sectors: list[list[float]], gap: float) -> np.ndarray:
    """Return which points lie in sectors of azimuth, half a gap away from their ends."""
    azimuth = np.degrees(np.arctan2(cloud.xyz[:, 1], cloud.xyz[:, 0])) % 360
    inside = np.zeros(len(cloud), np.bool_)
    for first, last in sectors:
        inside |= (azimuth - first - gap / 2) % 360 < (last - first) % 360 - gap
    return inside


def report(name: str, matrix: np.ndarray, scheme: ClassScheme) -> None:
    """Print a row of the table with its confusion matrix, and the same as JSON."""
    found = scores(matrix)
    print(f"\n{name}: overall accuracy {found.overall_accuracy:.4f}, mean F1 {found.mean_f1:.4f}")
    print(f"{'':20s}" + "".join(f"{c[:10]:>11s}" for c in scheme.classes) + f"{'F1':>8s}")
    for label, row in zip(scheme.classes, range(len(scheme)), strict=True):
        counts = "".join(f"{count:11d}" for count in matrix[row, : len(scheme)])
        print(f"{label:20s}{counts}{found.f1[row]:8.3f}")
    f1 = {c: round(float(v), 4) for c, v in zip(scheme.classes, found.f1, strict=True)}
    line = {"row": name, "overall_accuracy": found.overall_accuracy, "mean_f1": found.mean_f1, "f1": f1}
    print(json.dumps(line), flush=True)


def score(recording: Recording, scenes: list[dict[str, Any]], bundle: Any) -> np.ndarray:
    """Add up the confusion matrices of scenes."""
    scheme = recording.scheme
    total = np.zeros((len(scheme), len(scheme) + 1), np.int64)
    for scene in scenes:
        truth = scheme.encode(scene["scene"]["label"], source=scene["scene"].source)
        total += confusion_matrix(truth, label_scene(**scene, bundle=bundle)["label"], len(scheme))
    return total


def train(recording: Recording, scenes: list[dict[str, Any]], seed: int) -> Any:
    """Train a forest on prepared scenes."""
    rows = [training_rows(**scene, scheme=recording.scheme) for scene in scenes]
    forest = replace(recording.forest, seed=seed)
    bundle, _ = fit(
        rows, parameters=forest, stages=recording.stages, scheme=recording.scheme, trained_on={},
        n_jobs=os.cpu_count() or 1,
    )  # fmt: skip
    return bundle


def surveys_below(folder: Path) -> list[PointCloud]:
    """Read simulated surveys; of their columns a recording without colour and intensity has the labels alone."""
    clouds = []
    for path in sorted(folder.rglob("*.laz")):
        cloud = get_format(path).read(path, ReadOptions.from_config({"coding": "taxonomy"}))
        clouds.append(PointCloud(cloud.xyz, {"label": cloud["label"]}, source=path.parent.name))
    return clouds


def main() -> None:
    """Train, score and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recording", choices=list(PRESET))
    parser.add_argument("--seeds", type=int, nargs="+", default=[101, 102, 103, 104, 105, 106])
    parser.add_argument("--length", type=float)
    parser.add_argument("--kind", choices=list(STREETS), help="kind of street; the preset's own by default")
    parser.add_argument("--surveys", type=Path, help="train on the LAZ files below this folder")
    parser.add_argument("--forest-seeds", type=int, nargs="+", default=[2019])
    parser.add_argument("--without-real", action="store_true", help="leave out the forest trained on the recording")
    options = parser.parse_args()
    recording = Recording(options.recording)
    length = options.length or LENGTH[options.recording]
    if options.surveys:
        streets = surveys_below(options.surveys)
    else:
        preset = replace(PRESETS[PRESET[options.recording]], length=length)
        if options.kind:
            preset = replace(preset, street=STREETS[options.kind])
        streets = [cloud for seed in options.seeds for cloud in recording.simulate(replace(preset, seed=seed))]
    simulated = [recording.prepare(street) for street in streets]
    print(f"{len(streets)} simulated scenes with {sum(map(len, streets))} points", flush=True)
    real = {name: (recording.prepare(cloud), split) for name, (cloud, split) in recording.scenes().items()}
    test = [scene for scene, split in real.values() if split != "train"]
    for seed in options.forest_seeds:
        bundle = train(recording, simulated, seed)
        report(f"simulated to test split, seed {seed}", score(recording, test, bundle), recording.scheme)
        everything = [scene for scene, _ in real.values()]
        report(f"simulated to all, seed {seed}", score(recording, everything, bundle), recording.scheme)
        if not options.without_real:
            bundle = train(recording, [scene for scene, split in real.values() if split == "train"], seed)
            report(f"recorded train to test split, seed {seed}", score(recording, test, bundle), recording.scheme)


if __name__ == "__main__":
    main()

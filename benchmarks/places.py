"""Errors that a user meets in the first places of the page: in its order, in the order of questions, at random.

    kedro run --env=recordings
    python benchmarks/places.py [--folder FOLDER]

Scans of conf/recordings are placed in the frame of the drive (every fourth of PandaSet 002) and labelled as one survey
by the shipped model. A simulated user goes through the places of the page, and answers those of at least 100 points
within 40 m of the path (Oakland has none). An error is a place of which 80 % of the points with a reference have one
common class, and another one than the label. Places with the same points count once. Also prints, by reason for doubt,
the number of clusters and of wrong ones.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pandas as pd
import yaml
from _common import CONF, REPOSITORY, RESULTS, configured, configured_scheme, mlsroad, parser
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.stage_parameters import GroundParameters
from mlsroad_pipeline.algorithms.inventory.objects.doubts import FARTHEST, LEAST_POINTS, Cells, doubtful_clusters
from mlsroad_pipeline.algorithms.models.boosted_trees.segments import order_of_questions
from mlsroad_pipeline.algorithms.stages import find_ground
from mlsroad_pipeline.execution.collection import SceneCollection
from mlsroad_pipeline.execution.store import SceneStore
from mlsroad_pipeline.papers.comparison.recordings.parameters import Source, sources_of
from mlsroad_pipeline.review.page_server.output_folder import OutputFolder
from mlsroad_pipeline.review.page_server.point_groups import PointGroups
from mlsroad_pipeline.review.page_server.tile_building import build_tiles
from mlsroad_pipeline.review.page_server.tile_format import TileIndex

SCENES = "data/03_primary/recordings/recordings_study/scenes"
COMMON, FINE = configured_scheme("common"), configured_scheme("road_inventory")
PURE, FEWEST, STEPS = 0.8, 6, (20, 50)


def prepare(source: Source, store: SceneStore, folder: Path) -> None:
    """Write a recording as a survey with its path, and its reference; label it."""
    records = store.stored_records()
    names = sorted((k for k in records if k.partition(".")[0] == source.name), key=lambda k: (len(k), k))
    names = names[:: 4 if source.name == "pandaset_002" else 1]
    scenes = SceneCollection(store, {name: records[name] for name in names})
    parts, path = [], []
    for i, name in enumerate(names):
        cloud, pose = scenes[name].load(), source.pose(name.partition(".")[2])
        world = cloud.world_xyz().astype(np.float64)
        if pose is not None:
            world[:, :2] = pose.placed(world[:, :2])
            path.append((0.1 * i, pose.x, pose.y, 0.0))
        time = 0.1 * i + np.linspace(0, 0.09, len(cloud))
        intensity = cloud["intensity"] if "intensity" in cloud else 0 * time
        parts.append((world, intensity, COMMON.encode(cloud["label"], source=name), time))
    xyz, intensity, truth, time = (np.concatenate(column) for column in zip(*parts, strict=True))
    if source.name.startswith("pandaset"):  # it stands
        path = [(0.0, -0.5, 0.0, 0.0), (10.0, 0.5, 0.0, 0.0)]
    las = laspy.LasData(laspy.LasHeader(point_format=6, version="1.4"))
    las.header.scales = [0.001] * 3
    las.xyz, las.gps_time = xyz, time
    las.intensity = (intensity.astype(np.float64) / max(intensity.max(), 1e-9) * 65535).astype(np.uint16)
    folder.mkdir(parents=True)
    las.write(str(folder / "survey.laz"))
    np.save(folder / "truth.npy", truth)
    if path:
        pd.DataFrame(path, columns=["gps_time", "x", "y", "z"]).to_csv(folder / "trajectory.csv", index=False)
    mlsroad("label", folder / "survey.laz", "-o", folder / "out")


class User:
    """Simulated user of one recording."""

    def __init__(self, source: Source, folder: Path) -> None:
        self.source, self.truth = source, np.load(folder / "truth.npy").astype(np.int64)
        self.file, output = folder / "out/survey.laz", OutputFolder.find(folder / "out")
        if TileIndex.read(folder / "tiles") is None:
            build_tiles(output.clouds, folder / "tiles")
        self.names = output.class_names()
        path = np.array(output.path_vertices()).reshape(-1, 3) - output.clouds.origin
        self.groups = PointGroups(TileIndex.read(folder / "tiles"), names=self.names, path=path)

    def wrong(self, rows: NDArray[np.integer], name: str) -> bool:
        """Return whether most points with a reference have another class than the label."""
        known = self.truth[rows][self.truth[rows] >= 0]
        counts = np.bincount(known, minlength=len(COMMON))
        true = COMMON.classes[int(counts.argmax())]
        if name not in FINE.classes or 2 * len(known) < len(rows) or counts.max() < PURE * max(len(known), 1):
            return False
        label = COMMON.classes[FINE.coarsen(COMMON)[FINE.classes.index(name)]]
        return true in (*self.source.classes, "other") and label not in (true, *self.source.mixed.get(true, ()))

    def met(self, order: NDArray[np.int64]) -> list[int]:
        """Return the errors met in the first places."""
        seen, found = set[tuple[int, int, int]](), list[bool]()
        for segment in order[: 3 * max(STEPS)].tolist():
            code = int(self.groups._codes[segment])
            place = self.groups._sample.xyz[self.groups._places[segment]].astype(np.float64)
            rows = self.groups.points(place, code).rows
            can_judge = len(rows) >= LEAST_POINTS and not self.groups._facts[3][segment] > FARTHEST
            key = (code, len(rows), int(rows[0]) if len(rows) else -1)
            if len(found) < max(STEPS) and not (can_judge and key in seen):
                found.append(can_judge and self.wrong(rows, self.names[code]))
            seen.add(key)
        return [sum(found[:step]) for step in STEPS]

    def doubts(self) -> pd.DataFrame:
        """Return the doubtful clusters of all points, and whether each is wrong."""
        las = laspy.read(self.file)
        xyz, codes = np.asarray(las.xyz), np.asarray(las.classification)
        known = [self.names.get(code) for code in range(256)]
        label = np.array([FINE.classes.index(name) if name in FINE.classes else -1 for name in known])[codes]
        origin = np.floor(xyz.min(axis=0))
        ground = find_ground(PointCloud(xyz - origin, {}, origin), GroundParameters(**configured("ground_removal")))
        table, owner = doubtful_clusters(Cells(xyz - origin, np.nan_to_num(ground["height"]), label, FINE.classes))
        rows = [np.flatnonzero(owner == k) for k in range(len(table))]
        known_share = np.array([(self.truth[own] >= 0).mean() for own in rows], np.float64)
        wrong = [self.wrong(own, str(name)) for own, name in zip(rows, table["class"], strict=True)]
        return table.assign(wrong=wrong)[known_share >= 0.5]


def measured(user: User) -> dict[str, Any]:
    segments, large = user.groups._segments, np.flatnonzero(user.groups._segments.size >= FEWEST)
    random = [user.met(np.random.default_rng(seed).permutation(large)) for seed in range(5)]
    doubts = user.doubts().groupby("reason")["wrong"].agg(["size", "sum"])
    return {
        "page": user.met(np.array(user.groups.order(max(STEPS)))),
        "questions": user.met(order_of_questions(segments, len(large), least=FEWEST)),
        "random": np.mean(random, axis=0).tolist(),
        "doubts": {str(reason): [int(n), int(wrong)] for reason, n, wrong in doubts.itertuples()},
    }


def main() -> None:
    """Prepare and measure each recording."""
    arguments = parser(__doc__)
    arguments.add_argument("--folder", type=Path, default=RESULTS / "places")
    given = arguments.parse_args()
    config = yaml.safe_load((CONF / "recordings/parameters.yml").read_text(encoding="utf-8"))["recordings_study"]
    store = SceneStore(str(REPOSITORY / SCENES))
    for name, source in sources_of(config["sources"]).items():
        if not (given.folder / name / "out/inventory.gpkg").is_file():
            prepare(source, store, given.folder / name)
        print(source.title, measured(User(source, given.folder / name)), flush=True)


if __name__ == "__main__":
    main()

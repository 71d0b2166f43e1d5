"""Objects in files recognised fold by fold: the nodes between files and scores, and the environment's own default."""

import numpy as np
import pytest
from helpers.wiring import make_project, session_of
from kedro.framework.project import pipelines
from kedro.io import DataCatalog, MemoryDataset
from kedro.runner import SequentialRunner

from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.models.methods import methods_of
from mlsroad_pipeline.formats.base import WriteOptions
from mlsroad_pipeline.formats.sydney import SydneyFormat

RECOGNISERS = methods_of("recognition")

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]


def write_objects(root, rng):
    """Two folds of poles and cars as the Sydney Urban Objects are stored."""
    number = 0
    for fold in range(2):
        names = []
        for _ in range(6):
            for name, size in (("pole", [0.1, 0.1, 4.0]), ("car", [4.0, 1.6, 1.4])):
                xyz = rng.uniform(size=(60, 3)) * size + [10.0, 3.0, -1.5]
                xyz = xyz.astype(np.float32).astype(np.float64)
                columns = {
                    "gps_time": np.full(60, 1.3e9),
                    "intensity": np.full(60, 0.4, np.float32),
                    "id": np.zeros(60, np.uint8),
                    "azimuth": np.zeros(60, np.float32),
                    "range": np.linalg.norm(xyz, axis=1).astype(np.float32),
                    "pid": np.arange(60, dtype=np.int32),
                }
                names.append(f"{name}.{number}.1.bin")
                SydneyFormat().write(root / "objects" / names[-1], PointCloud(xyz, columns), WriteOptions())
                number += 1
        (root / "folds").mkdir(exist_ok=True)
        (root / "folds" / f"fold{fold}.txt").write_text("\n".join(names) + "\n", encoding="utf-8")


def test_files_of_objects_become_scores(tmp_path, rng):
    project = make_project(tmp_path / "project", tiny=False)
    write_objects(tmp_path / "survey", rng)
    given = {
        "survey": {"root": str(tmp_path / "survey")},
        "jointnet": {"training": {"epochs": 15, "n_members": 1, "n_turns": 1}},
        "hierarchy_descriptor": {"costs": [10.0], "gammas": [0.01], "n_folds": 2},
        "execution": {"backend": "sequential"},
    }
    with session_of(project, env="sydney", **given) as session:
        catalog: DataCatalog = session.load_context().catalog
        slugs = ("hierarchy_descriptor", "jointnet")
        for slug in slugs:
            catalog[f"{slug}.registered_model"] = MemoryDataset()
        whole = pipelines["object_recognition"]
        assert {n.name for n in pipelines["__default__"].nodes} == {n.name for n in whole.nodes}
        SequentialRunner().run(whole.to_outputs(*(f"{slug}.scores" for slug in slugs)), catalog)
        for slug in slugs:
            scores = catalog.load(f"{slug}.scores")
            assert list(dict.fromkeys(scores["split"])) == ["fold0", "fold1", "test"]
            values = scores[scores["class"] == "all"].set_index(["split", "metric"])["value"]
            assert values["test", "weighted_f1"] > 0.9
            assert catalog.load(f"{slug}.registered_model").classes[3] == "car"
    with session_of(project) as session:  # another environment of the same process has the comparison again
        session.load_context()
        assert {n.name for n in pipelines["__default__"].nodes} != {n.name for n in whole.nodes}


def test_every_recogniser_has_a_pipeline_that_ends_in_recognitions(tmp_path):
    with session_of(make_project(tmp_path / "project", tiny=False)):
        for slug in RECOGNISERS:
            assert f"{slug}.recognitions" in pipelines[slug].all_outputs()
        scored = {f"{slug}.scores" for slug in RECOGNISERS}
        assert scored | {"recognition_comparison"} <= pipelines["recognition"].all_outputs()
        assert (
            "scenes" in pipelines["recognition"].inputs() and "scenes" not in pipelines["object_recognition"].inputs()
        )

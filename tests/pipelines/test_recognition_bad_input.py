"""Recognisers through `label`: surveys of hardly any points, and models that are damaged or of other classes."""

from dataclasses import replace
from pathlib import Path

import laspy
import mlflow
import numpy as np
import pytest
from helpers.recognisers import PARAMETERS, car, pole, trained
from helpers.wiring import label, last_line, make_project, session_of
from kedro.framework.project import pipelines
from kedro.io import DataCatalog
from kedro.runner import SequentialRunner

from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.execution.output_lock import release_output
from mlsroad_pipeline.formats.base import WriteOptions
from mlsroad_pipeline.formats.las.format import LasFormat
from mlsroad_pipeline.model_store.bundle_files import load_bundle, save_bundle
from mlsroad_pipeline.model_store.registration import register_bundle

pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]

UTM = np.array([389_300.0, 5_819_700.0, 34.0])
POLE, CAR, UNCLASSIFIED = 64, 66, 1


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    return make_project(tmp_path_factory.mktemp("recognisers"), tiny=False)


def las(path, xyz):
    path.parent.mkdir(parents=True, exist_ok=True)
    LasFormat().write(path, PointCloud(np.asarray(xyz, np.float64), {}, UTM), WriteOptions(like="none"))


def street(rng):
    """A road with a pole and a car."""
    road = np.column_stack([rng.uniform(0, 25, 4000), rng.uniform(-5, 5, 4000), rng.normal(0, 0.01, 4000)])
    return np.concatenate([road, pole(rng, [5, 0, 0], n=200), car(rng, [15, 0, 0], n=400)])


def label_with(project, bundle, survey, output):
    """Label a survey with a model that is not in the registry."""
    given = {"label": {"survey": str(survey), "output": str(output)}, "execution": {"backend": "sequential"}}
    with session_of(project, **given) as session:
        catalog: DataCatalog = session.load_context().catalog
        catalog.save("label_model", bundle)
        try:
            SequentialRunner().run(pipelines["label"] - pipelines["label"].only_nodes("load_model"), catalog)
        finally:
            release_output(output)  # a hook does it in a session
    return output


@pytest.mark.parametrize("slug", PARAMETERS)
def test_objects_get_a_class_and_a_handful_of_points_none(project, tmp_path, rng, slug):
    for n_points in (1, 2, 3):
        las(tmp_path / f"in/few_{n_points}/few.laz", np.arange(3 * n_points).reshape(n_points, 3))
    las(tmp_path / "in/same/same.laz", np.zeros((500, 3)))
    las(tmp_path / "in/street/street.laz", street(rng))
    out = label_with(project, trained(rng, slug), tmp_path / "in", tmp_path / "out")
    for n_points in (1, 2, 3):
        few = laspy.read(out / f"few_{n_points}/few.laz")
        assert (few.classification == UNCLASSIFIED).all() and (few["confidence"] == 0).all()
    same = laspy.read(out / "same/same.laz")
    assert len(same.points) == 500 and len(np.unique(same.classification)) == 1
    found = laspy.read(out / "street/street.laz")
    assert np.isfinite(found["confidence"]).all()
    high = found.z - UTM[2] > 0.5
    assert np.isin(found.classification[high], [POLE, CAR]).mean() > 0.95
    assert (found.classification[~high] == UNCLASSIFIED).mean() > 0.9


def test_registered_models_whose_files_were_changed_or_damaged_are_refused(project, tmp_path, rng):
    las(tmp_path / "street.laz", street(rng))
    with session_of(project) as session:
        session.load_context()
        register_bundle(trained(rng, "jointnet"), "mlsroad-jointnet")
        folder = Path(mlflow.artifacts.download_artifacts("models:/mlsroad-jointnet/1")) / "artifacts/bundle"
    good = load_bundle(folder)
    arrays = {name: np.array(values) for name, values in good.arrays.items()}
    save_bundle(replace(good, arrays={**arrays, "classes": np.array([0, 2])}), folder)
    with pytest.raises(Exception) as caught:  # what the user reads last is what counts
        label(project, tmp_path / "street.laz", tmp_path / "out", method="jointnet")
    assert "artifacts/bundle differs from the files that were registered" in last_line(caught.value)
    whole = (folder / "arrays.npz").read_bytes()
    (folder / "arrays.npz").write_bytes(whole[:-100])
    with pytest.raises(Exception) as caught:
        label(project, tmp_path / "street.laz", tmp_path / "out", method="jointnet")
    said = last_line(caught.value)
    assert "artifacts/bundle differs from the files that were registered" in said and str(folder) in said, said

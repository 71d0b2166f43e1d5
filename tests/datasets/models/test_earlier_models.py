"""Models that earlier versions of the package stored: their entry points and their code name modules of before."""

import json

import mlflow
import numpy as np
import pandas as pd
import pytest
from helpers.wiring import empty_store

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.models.labelling import _labeller, label_cloud
from mlsroad_pipeline.algorithms.models.members import member
from mlsroad_pipeline.algorithms.models.methods import METHODS
from mlsroad_pipeline.datasets.models.bundle_files import load_bundle
from mlsroad_pipeline.datasets.models.model_registry_dataset import (
    RegisteredModelDataset,
    example_points,
    register_bundle,
)
from mlsroad_pipeline.datasets.models.point_labeller import signature, table_to_cloud

SCIENCE = "mlsroad_pipeline.algorithms"
ENTRY_POINTS = {
    "detrended_forest": "detrended_forest.labeller:label_cloud",
    "patch_graph": "patch_graph.labeller:label_cloud",
    "patch_graph_mrf": "patch_graph.labeller:label_cloud_refined",
    "patch_svm": "baselines.patch_svm:label_cloud",
    "patch_forest": "baselines.patch_forest:label_cloud",
    "shape_based": "baselines.shape_based:label_cloud",
    "max_margin_markov": "baselines.max_margin_markov:label_cloud",
    "image_labels": "model_bundle:refuse_points",
    "fusion": "model_bundle:refuse_points",
    "visual_words": "visual_words.labeller:label_cloud",
    "hough_forest": "baselines.hough_forest:label_cloud",
    "object_matching": "baselines.object_matching:label_cloud",
    "bottom_up_top_down": "baselines.bottom_up_top_down:label_cloud",
    **dict.fromkeys(
        ("jointnet", "jointnet_tuned", "jointnet_printed", "hssi_net", "vqai_net", "vaai_net", "spin_image", "shot",
         "hierarchy_descriptor", "pointnet"),
        "recognisers:label_cloud",
    ),
}  # fmt: skip
CODE = '''"""The code that MLflow stores beside a registered model and runs to load it: all of it lives in this package."""

from mlflow.models import set_model

from mlsroad_pipeline.datasets.point_labeller import PointLabeller

set_model(PointLabeller())
'''
CLASSES = ["ground", "object"]
SCHEME = {"name": "two", "classes": CLASSES, "members": [["road"], ["car"]], "ignored": [], "asprs": [11, 66]}
FOREST = {
    "roots": np.array([0, 3]),
    "feature": np.array([16, -1, -1], np.int16),  # the height, after 16 bins
    "threshold": np.array([0.5, 0, 0], np.float32),
    "missing_left": np.zeros(3, np.bool_),
    "child": np.array([1, 0, 1], np.int32),
    "leaf_values": np.eye(2, dtype=np.float32),
    "n_features": np.array(17),
}


def metadata_of(slug, **more):
    entry_point = f"{SCIENCE}.{ENTRY_POINTS[slug]}"
    return {"entry_point": entry_point, "classes": CLASSES, "scheme": SCHEME, "attributes": [], **more}


@pytest.fixture(scope="module")
def stored(tmp_path_factory):
    """A patch forest of one split in the files of an earlier version: objects are higher than half a metre."""
    folder = tmp_path_factory.mktemp("before") / "bundle"
    folder.mkdir()
    arrays = {f"geometry.{name}": values for name, values in FOREST.items()}
    arrays |= {"n_classes": np.array(2), "trained_classes": np.array([0, 1])}
    np.savez(folder / "arrays.npz", **arrays)
    parameters = {
        "patch_forest": {"n_trees": 1, "max_depth": 1, "max_per_class": 10, "seed": 2016},
        "ground": {"voxel_size": 0.1, "block_size": 8.0, "local_height": 0.2, "global_height": 0.3,
                   "reference": "surface", "surface_cell": 0.5},
        "patches": {"patch_size": 0.2, "voxel_size": 0.1, "normal_radius": 0.3, "fpfh_radius": 0.8, "n_bins": 4,
                    "use_distance": True, "area_radius": 0.3},
    }  # fmt: skip
    metadata = metadata_of("patch_forest", parameters=parameters, trained_on={"survey": "a street"})
    content = {"format": 1, "slug": "patch_forest", "arrays": sorted(arrays), "metadata": metadata}
    (folder / "model.json").write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
    return folder


def street():
    """Return a flat patch of ground with a post of two metres."""
    x, y = np.meshgrid(np.arange(0, 4, 0.1), np.arange(0, 4, 0.1))
    ground = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    post = np.column_stack([np.full(20, 2.0), np.full(20, 2.0), np.arange(0.1, 2.1, 0.1)])
    return pd.DataFrame(np.concatenate([ground, post]), columns=["x", "y", "z"])


def test_entry_points_of_before_cover_the_table():
    later = {"boosted_trees", "multiscale_forest", "superpoint_transformer", "visual_words_printed"}
    later |= {"patch_graph_printed", "patch_graph_mrf_printed"}
    assert set(METHODS) - set(ENTRY_POINTS) == later and set(ENTRY_POINTS) < set(METHODS)


@pytest.mark.parametrize("slug", ENTRY_POINTS)
def test_the_labeller_of_a_stored_model_is_found_by_its_slug(slug):
    labeller = _labeller(ModelBundle(slug, {}, metadata_of(slug)))
    assert labeller is METHODS[slug].load("label_cloud")


def test_a_stored_model_labels_points(stored):
    table = street()
    labels, confidence = label_cloud(load_bundle(stored), table_to_cloud(table))
    far = table["z"].to_numpy() > 0.9  # points near the split share the votes of patches around them
    assert (labels[table["z"] == 0] == 0).mean() > 0.99 and (labels[far] == 1).all()
    assert confidence.min() >= 0.5


def test_stored_members_are_opened_and_points_alone_refused():
    members = {name: metadata_of(name, trained_on={}) for name in ("detrended_forest", "image_labels")}
    fusion = ModelBundle("fusion", {"detrended_forest/a": np.zeros(1)}, metadata_of("fusion", members=members))
    inner = member(fusion, "detrended_forest")
    assert (
        list(inner.arrays) == ["a"]
        and inner.metadata["entry_point"] == f"{SCIENCE}.detrended_forest.labeller:label_cloud"
    )
    for bundle in (fusion, member(fusion, "image_labels")):
        with pytest.raises(ParameterError, match="needs images; it cannot label points alone"):
            label_cloud(bundle, PointCloud(np.zeros((1, 3))))


def test_a_registered_model_is_loaded_and_predicts(stored, tmp_path):
    code = tmp_path / "registered_model_code.py"
    code.write_text(CODE, encoding="utf-8")
    (tmp_path / "mlflow.db").write_bytes(empty_store())
    before, name = mlflow.get_tracking_uri(), "mlsroad-patch_forest"
    mlflow.set_tracking_uri(f"sqlite:///{tmp_path / 'mlflow.db'}")
    try:
        mlflow.set_experiment(
            experiment_id=mlflow.create_experiment("before", artifact_location=(tmp_path / "artifacts").as_uri())
        )
        with mlflow.start_run():
            mlflow.pyfunc.log_model(
                name=name,
                python_model=str(code),
                artifacts={"bundle": str(stored)},
                signature=signature(),
                input_example=example_points(),
                registered_model_name=name,
            )
        bundle = RegisteredModelDataset(name=name).load()
        predicted = mlflow.pyfunc.load_model(f"models:/{name}/1").predict(street())
        labels, _ = label_cloud(bundle, table_to_cloud(street()))
        assert predicted["label"].tolist() == labels.tolist() and set(predicted["class"]) == set(CLASSES)
        assert register_bundle(bundle, name)[1]  # registered again with the code of today
        pd.testing.assert_frame_equal(mlflow.pyfunc.load_model(f"models:/{name}/2").predict(street()), predicted)
    finally:
        mlflow.set_tracking_uri(before)

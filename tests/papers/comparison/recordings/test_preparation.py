"""Preparation and training in the benchmark of recordings: superpoint graphs of whole scenes and of own parts."""

import numpy as np
from references.patches import SCHEME, street

from mlsroad_pipeline.algorithms.core.stage_parameters import FeatureParameters, GroundParameters, SupervoxelParameters
from mlsroad_pipeline.algorithms.models.labelling import label_cloud
from mlsroad_pipeline.algorithms.models.superpoint_transformer.parameters import SuperpointTransformerParameters
from mlsroad_pipeline.algorithms.scenes.parts import TRAIN
from mlsroad_pipeline.papers.comparison.recordings.preparation import Prepared, Setup, preparation_of, prepare

SLUG = "superpoint_transformer"


def test_superpoint_graphs_hold_the_labels_of_their_use_and_train_a_model():
    small = {"network": {"width": 16}, "training": {"n_steps": 2, "batch_size": 2, "n_points": 8}}
    stages = {"ground_removal": GroundParameters(), "supervoxelise": SupervoxelParameters()}
    parameters = {**stages, "features": FeatureParameters(), SLUG: SuperpointTransformerParameters(**small)}
    preparation, cloud = preparation_of(SLUG), street(0, n=800)
    cloud = cloud.with_columns(part=np.where(cloud.xyz[:, 0] < 2, TRAIN, TRAIN + 1))
    given = {"kind": preparation.kind, "stages": preparation.stages(parameters)}
    parts = prepare({"a": cloud}, **given, scheme=SCHEME, mixed=["shrub"])
    assert sorted(parts) == ["a.scanned.own", "a.scanned.whole", "a.view_1.own", "a.view_1.whole"]
    truth, core = SCHEME.encode(cloud["label"], source=cloud.source), cloud["core"]
    for use, counted in (("own", cloud["part"] == TRAIN), ("whole", truth != SCHEME.classes.index("shrub"))):
        expected = np.bincount(truth[counted & core], minlength=len(SCHEME))
        assert parts[f"a.scanned.{use}"]["level_1.histogram"].sum(axis=0).tolist() == expected.tolist()
    bundle = preparation.fit([Prepared(parts, "own")], Setup(SLUG, parameters, SCHEME, {"training": "own.a"}))
    assert bundle.metadata["trained_on"] == {"training": "own.a", "graphs": 2}
    assert len(label_cloud(bundle, cloud)[0]) == len(cloud)

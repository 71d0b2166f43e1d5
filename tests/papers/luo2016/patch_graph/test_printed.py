"""The variants of the patch match graph with the values of Luo et al. 2016."""

import dataclasses

import numpy as np
from helpers.conf import base
from references.patches import SCHEME, prepare, street

from mlsroad_pipeline.algorithms.core.stage_parameters import GroundParameters
from mlsroad_pipeline.algorithms.models.labelling import label_cloud
from mlsroad_pipeline.algorithms.models.methods import METHODS
from mlsroad_pipeline.model_store.bundle_files import load_bundle, save_bundle
from mlsroad_pipeline.papers.luo2016.patch_graph.classifier import PatchGraphParameters
from mlsroad_pipeline.papers.luo2016.patch_graph.costs import CostWeights
from mlsroad_pipeline.papers.luo2016.patch_graph.refined_classifier import GridParameters
from mlsroad_pipeline.papers.shared.patches.extraction import PatchParameters, PatchStages
from mlsroad_pipeline.papers.shared.patches.labelling import label_patches
from mlsroad_pipeline.papers.shared.patches.training import PatchTraining, join_training_scenes


def test_the_printed_values_are_those_of_the_paper():
    graph = PatchGraphParameters(**base("patch_graph_printed"))
    assert (graph.n_matches, graph.scene_length) == (7, 10.0)  # Table II, section IV-A
    assert graph.max_patches >= 10**6  # no patch is left out
    assert graph.weights == CostWeights(colour=0.3, height=0.3, shape=0.4, max_height=20.0)  # Table II
    search = dataclasses.asdict(graph.search)
    assert {name: search[name] for name in ("propagation_radius", "search_radius", "n_iterations")} == {
        "propagation_radius": 0.5, "search_radius": 1.0, "n_iterations": 50,
    }  # fmt: skip
    assert (search["minority_share"], search["n_costly"]) == (0.001, 10)  # section IV-B
    # What the paper does not have: descriptor clusters, matches that are not followed, an early end, more searches.
    assert (search["n_probes"], search["promise"]) == (0, float("inf"))
    assert (search["tolerance"], search["exhaustive_budget"]) == (0.0, 0)
    field = GridParameters(**base("patch_graph_mrf_printed"))
    assert (field.ground_penalty, field.smooth_ground) == (0.0, False)  # gamma and equation 11
    sizes = PatchParameters(**base("patches"))
    assert (sizes.patch_size, sizes.area_radius) == (0.2, 0.3)  # Table II, section IV-B
    assert sizes.n_bins * (4 if sizes.use_distance else 3) == 16  # equation 4


def test_printed_models_are_stored_and_label_a_cloud(tmp_path):
    clouds = {f"train.{seed}": street(seed, n=600) for seed in range(2)}
    patches = {key: prepare(cloud) for key, cloud in clouds.items()}
    labels = {key: label_patches(cloud, patches[key], SCHEME) for key, cloud in clouds.items()}
    stages = PatchStages(GroundParameters(), PatchParameters())
    training = PatchTraining(*join_training_scenes(patches, labels), stages, SCHEME, {})
    printed = {**base("patch_graph_printed"), "n_matches": 3, "scene_length": 3.0}
    parameters = PatchGraphParameters(**printed)
    graph = METHODS["patch_graph_printed"].load("train")(training, slug="patch_graph_printed", parameters=parameters)
    refined = METHODS["patch_graph_mrf_printed"].load("train")(
        training,
        graph,
        slug="patch_graph_mrf_printed",
        graph_parameters=parameters,
        parameters=GridParameters((0.2,), (0.0, 10.0)),
    )
    assert (graph.slug, refined.slug) == ("patch_graph_printed", "patch_graph_mrf_printed")
    assert refined.metadata["graph"]["search"]["promise"] == "inf"
    assert refined.metadata["chosen"]["colour_decay"] in (0.0, 10.0)
    cloud = street(9, n=600)
    truth = SCHEME.encode(cloud["label"])
    for bundle in (graph, refined):
        save_bundle(bundle, tmp_path / bundle.slug)
        found, _ = label_cloud(load_bundle(tmp_path / bundle.slug), cloud)
        assert found.tolist() == label_cloud(bundle, cloud)[0].tolist()
        assert np.mean(found == truth) > 0.8

"""Preparation of training scenes for each method, training on prepared scenes, and trained models as arrays."""

import json
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.stage_parameters import GroundParameters, StageParameters
from mlsroad_pipeline.algorithms.models.boosted_trees.parameters import SLUG as TREES
from mlsroad_pipeline.algorithms.models.boosted_trees.parameters import BoostedTreesParameters
from mlsroad_pipeline.algorithms.models.boosted_trees.sampling import training_voxels
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.models.methods import METHODS
from mlsroad_pipeline.algorithms.models.superpoint_transformer import labeller as superpoint_transformer
from mlsroad_pipeline.algorithms.models.superpoint_transformer.parameters import SLUG as SUPERPOINTS
from mlsroad_pipeline.algorithms.models.superpoint_transformer.parameters import SuperpointTransformerParameters
from mlsroad_pipeline.algorithms.models.superpoint_transformer.training_graphs import training_graphs
from mlsroad_pipeline.algorithms.scenes.parts import TRAIN
from mlsroad_pipeline.algorithms.stages import build_supervoxels, describe_supervoxels, find_ground
from mlsroad_pipeline.execution.task import StoredResult
from mlsroad_pipeline.papers.comparison.recordings.parameters import OWN
from mlsroad_pipeline.papers.comparison.recordings.streets import ignoring, scenes_in
from mlsroad_pipeline.papers.luo2016.shape_based import labeller as shape_based
from mlsroad_pipeline.papers.shared.patches.extraction import PatchStages
from mlsroad_pipeline.papers.shared.patches.labelling import build_patches, label_patches
from mlsroad_pipeline.papers.shared.patches.training import PatchTraining, join_training_scenes
from mlsroad_pipeline.papers.tomic2019.detrended_forest.training import fit as fit_forest
from mlsroad_pipeline.papers.tomic2019.detrended_forest.training import training_rows


class Prepared(NamedTuple):
    """Prepared scenes of a file of a recording, or of a simulated street."""

    parts: Mapping[str, Mapping[str, NDArray]]  # ``<scene>.<what>`` to arrays
    use: str  # the labels that train
    source: str = ""  # recording, or one name for all streets
    weight: float = 1.0  # of the whole source, for methods that weigh sources

    def labelled(self) -> list[Mapping[str, NDArray]]:
        """Return the parts with the labels of the use."""
        return [arrays for name, arrays in self.parts.items() if name.endswith(f".{self.use}")]

    def scene_names(self) -> list[str]:
        """Return the names of the scenes."""
        return sorted({part.partition(".")[0] for part in self.parts})


class Setup(NamedTuple):
    """Method to train, the parameters of all groups, the classes, and facts of the training data for the model."""

    method: str
    parameters: Mapping[str, Any]
    scheme: ClassScheme
    facts: Mapping[str, Any]

    @property
    def own(self) -> Any:
        """Return the parameters of the method."""
        return self.parameters[self.method]


@dataclass(frozen=True)
class Preparation:
    """Preparation of the scenes of a method, and its training on them."""

    kind: str  # one of `_PARTS`; methods of one kind share the prepared scenes
    stages: Callable[[Mapping[str, Any]], Any]  # takes the parameters of all groups
    fit: Callable[[Sequence[Prepared], Setup], ModelBundle]


def labelled_for(
    scenes: PointCloud | Mapping[str, PointCloud], scheme: ClassScheme, mixed: Sequence[str]
) -> Iterator[tuple[str, dict[str, PointCloud]]]:
    """Yield each scene with the labels of each use.

    Used for other recordings (``whole``), points of a class that holds others are ignored; used for the recording's own
    part (``own``), all points outside of the training part are.
    """
    for name, cloud in scenes_in(scenes).items():
        truth = scheme.encode(cloud["label"], source=cloud.source)
        uses = {"whole": ignoring(cloud, np.isin(truth, scheme.labels_of(mixed)))}
        if "part" in cloud:
            uses[OWN] = ignoring(cloud, cloud["part"] != TRAIN)
        yield name, uses


def prepare_supervoxels(uses: dict[str, PointCloud], stages: StageParameters, scheme: ClassScheme) -> dict[str, Any]:
    """Compute the labelled supervoxels of a scene for each use."""
    cloud = uses["whole"]
    ground = find_ground(cloud, stages.ground)
    supervoxels = build_supervoxels(cloud, stages.supervoxels)
    features = describe_supervoxels(cloud, ground, supervoxels, stages.features)
    return {use: training_rows(one, supervoxels, features, scheme=scheme) for use, one in uses.items()}


def _fit_forest(scenes: Sequence[Prepared], setup: Setup) -> ModelBundle:
    rows: list[Any] = [arrays for scene in scenes for arrays in scene.labelled()]
    bundle, _ = fit_forest(
        [row for row in rows if len(row["labels"])],
        parameters=setup.own, stages=_forest_stages(setup.parameters), scheme=setup.scheme, trained_on=setup.facts,
    )  # fmt: skip
    return bundle


def _forest_stages(parameters: Mapping[str, Any]) -> StageParameters:
    return StageParameters(*(parameters[name] for name in ("ground_removal", "supervoxelise", "features")))


def prepare_patches(uses: dict[str, PointCloud], stages: PatchStages, scheme: ClassScheme) -> dict[str, Any]:
    """Cut a scene into patches, with ground and classes for each use."""
    ground = find_ground(uses["whole"], stages.ground)
    patches = build_patches(uses["whole"], ground, stages.patches)
    labels = {use: label_patches(labelled, patches, scheme) for use, labelled in uses.items()}
    return {"patches": patches, "ground": {"ground": ground["ground"]}, **labels}


def _patch_stages(parameters: Mapping[str, Any]) -> PatchStages:
    return PatchStages(parameters["ground_removal"], parameters["patches"])


def _patches_of(scenes: Sequence[Prepared]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the patches of all scenes and their classes, by number."""
    patches: dict[str, Any] = {}
    labels: dict[str, Any] = {}
    for scene in scenes:
        for name in scene.scene_names():
            key = f"{len(patches):04d}"
            patches[key], labels[key] = scene.parts[f"{name}.patches"], scene.parts[f"{name}.{scene.use}"]
    return patches, labels


def _fit_patches(scenes: Sequence[Prepared], setup: Setup) -> ModelBundle:
    joined = join_training_scenes(*_patches_of(scenes))
    numbers = np.array([number for number, scene in enumerate(scenes) for name in scene.parts if ".patches" in name])
    training = PatchTraining(
        *joined, _patch_stages(setup.parameters), setup.scheme, setup.facts, numbers.astype(np.int32)
    )
    graph, train = METHODS[setup.method].refines, METHODS[setup.method].load("train")
    if not graph:
        bundle: ModelBundle = train(training, slug=setup.method, parameters=setup.own)
        return bundle
    own = setup.parameters[graph]
    transfer = METHODS[graph].load("train")(training, slug=graph, parameters=own)
    refined: ModelBundle = train(training, transfer, slug=setup.method, graph_parameters=own, parameters=setup.own)
    return refined


def _fit_shapes(scenes: Sequence[Prepared], setup: Setup) -> ModelBundle:
    objects = []
    for scene in scenes:
        for name in scene.scene_names():
            patches: Any = scene.parts[f"{name}.patches"]
            ground: Any = scene.parts[f"{name}.ground"]
            built = shape_based.build_objects(ground, patches, setup.own)
            truth = scene.parts[f"{name}.{scene.use}"]["label"]
            objects.append(shape_based.labelled_objects(built, truth, len(setup.scheme)))
    return shape_based.fit(
        objects,
        parameters=setup.own,
        stages=_patch_stages(setup.parameters),
        scheme=setup.scheme,
        trained_on=setup.facts,
    )


GraphStages = tuple[StageParameters, SuperpointTransformerParameters]


def prepare_graphs(uses: dict[str, PointCloud], stages: GraphStages, scheme: ClassScheme) -> dict[str, Any]:
    """Build the labelled graphs of superpoints of a scene for each use, as scanned and in views of virtual scanners."""
    prepared = superpoint_transformer.prepare(uses["whole"], stages[0], fresh=True)
    out: dict[str, Any] = {}
    for use, labelled in uses.items():
        graphs = training_graphs(labelled, *prepared, parameters=stages[1], stages=stages[0], scheme=scheme)
        out |= {f"{view}.{use}": graph for view, graph in graphs.items()}
    return out


def _graph_stages(parameters: Mapping[str, Any]) -> GraphStages:
    return _forest_stages(parameters), parameters[SUPERPOINTS].of_graphs()


def _fit_graphs(scenes: Sequence[Prepared], setup: Setup) -> ModelBundle:
    graphs = [arrays for scene in scenes for arrays in scene.labelled()]
    bundle: ModelBundle = METHODS[setup.method].load("train")(
        graphs,
        parameters=setup.own,
        stages=_graph_stages(setup.parameters)[0],
        scheme=setup.scheme,
        trained_on=setup.facts,
    )[0]
    return bundle


VoxelStages = tuple[GroundParameters, BoostedTreesParameters]


def prepare_voxels(uses: dict[str, PointCloud], stages: VoxelStages, scheme: ClassScheme) -> dict[str, Any]:
    """Draw the labelled voxels of a scene for each use."""
    ground = find_ground(uses["whole"], stages[0])
    return {use: training_voxels(one, ground, parameters=stages[1], scheme=scheme) for use, one in uses.items()}


def _voxel_stages(parameters: Mapping[str, Any]) -> VoxelStages:
    return parameters["ground_removal"], parameters[TREES].of_sample()


def _fit_voxels(scenes: Sequence[Prepared], setup: Setup) -> ModelBundle:
    voxels = [(arrays, scene) for scene in scenes for arrays in scene.labelled()]
    bundle: ModelBundle = METHODS[setup.method].load("train")(
        [arrays for arrays, _ in voxels],
        parameters=setup.own, ground=setup.parameters["ground_removal"], scheme=setup.scheme, trained_on=setup.facts,
        sources=[scene.source for _, scene in voxels], weights=[scene.weight for _, scene in voxels],
    )  # fmt: skip
    return bundle


_PARTS: dict[str, Callable[..., dict[str, Any]]] = {
    "supervoxels": prepare_supervoxels,
    "patches": prepare_patches,
    "superpoint_graphs": prepare_graphs,
    "voxels": prepare_voxels,
}


def prepare(
    scenes: PointCloud | Mapping[str, PointCloud], *, kind: str, stages: Any, scheme: ClassScheme, mixed: Sequence[str]
) -> dict[str, Any]:
    """Return the parts of all scenes for a kind of preparation, ``<scene>.<part>``."""
    return {
        f"{name}.{part}": arrays
        for name, uses in labelled_for(scenes, scheme, mixed)
        for part, arrays in _PARTS[kind](uses, stages, scheme).items()
    }


_FOREST = Preparation("supervoxels", _forest_stages, _fit_forest)
_PATCHES = Preparation("patches", _patch_stages, _fit_patches)
_SHAPES = Preparation("patches", _patch_stages, _fit_shapes)
_GRAPHS = Preparation("superpoint_graphs", _graph_stages, _fit_graphs)
_VOXELS = Preparation("voxels", _voxel_stages, _fit_voxels)
_OF_METHOD = {
    "detrended_forest": _FOREST,
    "shape_based": _SHAPES,
    SUPERPOINTS: _GRAPHS,
    TREES: _VOXELS,
    **dict.fromkeys(
        (
            "patch_graph", "patch_graph_mrf", "patch_graph_printed", "patch_graph_mrf_printed", "patch_svm",
            "patch_forest", "max_margin_markov",
        ),
        _PATCHES,
    ),
}  # fmt: skip


def preparation_of(method: str) -> Preparation:
    """Return the preparation and training of a method."""
    if method not in _OF_METHOD:
        raise ParameterError(f"the benchmark of recordings cannot train {method}: add it to its preparation.py")
    return _OF_METHOD[method]


def train_model(
    prepared: Sequence[StoredResult],
    *,
    method: str,
    uses: Mapping[str, tuple[str, str, float]],
    parameters: Mapping[str, Any],
    scheme: ClassScheme,
    trained_on: Mapping[str, Any],
) -> dict[str, dict[str, NDArray]]:
    """Train a method; the result has the arrays, the metadata as JSON, and the time of training without preparation."""
    scenes = [Prepared(handle.load(), *uses[handle.key]) for handle in prepared]
    start, used = time.perf_counter(), time.process_time()
    bundle = preparation_of(method).fit(scenes, Setup(method, parameters, scheme, trained_on))
    seconds = {"seconds": time.perf_counter() - start, "cpu_seconds": time.process_time() - used}
    return {**model_arrays(bundle), "times": {name: np.array(value) for name, value in seconds.items()}}


def model_arrays(bundle: ModelBundle) -> dict[str, dict[str, NDArray]]:
    """Return a model as arrays; `stored_model` is the inverse."""
    metadata = {"slug": np.array(bundle.slug), "json": np.array(json.dumps(dict(bundle.metadata)))}
    return {"arrays": dict(bundle.arrays), "metadata": metadata}


def stored_model(model: Mapping[str, Mapping[str, NDArray]]) -> ModelBundle:
    """Return the model of arrays of `model_arrays`."""
    metadata = json.loads(str(model["metadata"]["json"]))
    return ModelBundle(str(model["metadata"]["slug"]), model["arrays"], metadata)

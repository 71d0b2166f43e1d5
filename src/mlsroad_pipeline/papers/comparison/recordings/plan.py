"""Runs of the benchmark of recordings, and the tasks of its stages."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from mlsroad_pipeline.algorithms.core.classes import ClassScheme, find_scheme
from mlsroad_pipeline.algorithms.core.codings import Coding
from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.stage_parameters import FeatureParameters, GroundParameters, SupervoxelParameters
from mlsroad_pipeline.algorithms.models.boosted_trees.parameters import SLUG as TREES
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.models.methods import METHODS, methods_of
from mlsroad_pipeline.algorithms.models.pool.labeller import SLUG as POOL
from mlsroad_pipeline.execution.collection import SceneCollection
from mlsroad_pipeline.execution.task import Deferred, SceneTask, SourceFile
from mlsroad_pipeline.papers.comparison.recordings import parameters as recordings
from mlsroad_pipeline.papers.comparison.recordings.preparation import model_arrays, preparation_of, prepare, train_model
from mlsroad_pipeline.papers.comparison.recordings.scoring import score_source
from mlsroad_pipeline.papers.comparison.recordings.streets import make_scenes
from mlsroad_pipeline.papers.shared.patches.extraction import PatchParameters
from mlsroad_pipeline.papers.shared.studies.parameters import method_parameters
from mlsroad_pipeline.simulation.parameters.presets import simulation_parameters
from mlsroad_pipeline.surveys.recordings import read_scene

WHOLE = "whole"
"""Use of all labels of a scene; `OWN` is that of the labels of the training part."""


class Run(NamedTuple):
    """Scoring of a method, or of a model of the package, that was trained by a protocol, on a recording."""

    method: str
    protocol: str
    source: str

    @property
    def key(self) -> str:
        """Return the key in the store."""
        return ".".join(self)

    @property
    def trained(self) -> str:
        """Return the method that is trained: the trees of the pool, whose network is that of the package."""
        return TREES if self.method == POOL else self.method

    @classmethod
    def parse(cls, key: str) -> Run:
        """Return the run of a key."""
        return cls(*key.split("."))


@dataclass(frozen=True)
class StudyPlan:
    """Parameters of all stages of the benchmark, and the runs that follow from them."""

    study: recordings.StudyParameters
    sources: Mapping[str, recordings.Source]
    codings: Mapping[str, Coding]  # recording to the coding of its labels
    scheme: ClassScheme
    parameters: Mapping[str, Any]  # group or slug to parameters

    @property
    def root(self) -> Path:
        """Return the folder of the recordings."""
        return Path(self.study.root)

    def runs(self) -> list[Run]:
        """Return the runs that are requested."""
        chosen = self.study
        methods = {slug: recordings.PROTOCOLS[1:] for slug in methods_of("labelling")}
        models = {name: recordings.PROTOCOLS if name == POOL else (recordings.SHIPPED,) for name in chosen.models}
        every: dict[str, tuple[str, ...]] = {**models, **methods}
        for what, name, known in (("method", chosen.method, every), ("source", chosen.source, self.sources)):
            if name is not None and name not in known:
                raise ParameterError(f"recordings_study.{what} {name!r} is none of {', '.join(known)}")
        found = [
            Run(method, protocol, source)
            for method, protocols in every.items()
            for protocol in protocols
            for source in self.sources
            if (method != POOL or protocol == recordings.SHIPPED or source not in chosen.seen)
            and chosen.method in (None, method)
            and chosen.protocol in (None, protocol)
            and chosen.source in (None, source)
        ]
        if not found:
            raise ParameterError(
                f"recordings_study.method {chosen.method!r} has no protocol {chosen.protocol!r}: models of the package "
                f"have {recordings.SHIPPED!r}, labellers the others, {POOL!r} all"
            )
        return found

    def training_set(self, run: Run) -> str:
        """Return the name of the training data of a run; runs of one name share a model."""
        if run.protocol == recordings.SIMULATED:
            return recordings.SIMULATED
        name = self.sources[run.source].left_out if run.protocol == recordings.OTHERS else run.source
        return f"{run.protocol}.{name}"

    def used_sources(self, run: Run) -> list[str]:
        """Return the recordings that a run is trained on."""
        if run.protocol in (recordings.OWN, recordings.BOTH):
            return [run.source]
        if run.protocol == recordings.OTHERS:
            left_out = self.sources[run.source].left_out
            return [name for name, source in self.sources.items() if source.left_out != left_out]
        return []

    def source_of(self, key: str) -> tuple[str, float]:
        """Return the source of a training scene, one for all streets, and its weight."""
        name = key.partition(".")[0]
        return name, self.study.street_weight if name == STREET else 1.0

    def training_scenes(self, run: Run) -> dict[str, str]:
        """Return the scenes that a run is trained on, with their use (`WHOLE` or `OWN`)."""
        use = recordings.OWN if run.protocol in (recordings.OWN, recordings.BOTH) else WHOLE
        scenes = (
            {}
            if run.protocol in (recordings.OWN, recordings.SHIPPED)
            else {street_key(name): WHOLE for name in self.streets()}
        )
        for name in self.used_sources(run):
            source = self.sources[name]
            paths = source.paths(self.root)
            stems = [stem for stem, path in paths.items() if use == WHOLE or not source.is_test_block(path)]
            count = min(len(stems), self.study.scenes_per_source)
            places = np.unique(np.linspace(0, len(stems) - 1, count).round().astype(np.int64))
            scenes |= {f"{name}.{stems[place]}": use for place in places}
        return scenes

    def streets(self) -> dict[str, Mapping[str, Any]]:
        """Return the configurations of the simulated streets; null switches one off."""
        return {name: config for name, config in self.study.streets.items() if config is not None}

    def parameters_of(self, method: str) -> dict[str, Any]:
        """Return the parameters of the stages, of a method, and of the method that it refines.

        Parameters of other methods do not change the model; they would make it be trained again.
        """
        return {
            name: values for name, values in self.parameters.items() if name not in METHODS or method.startswith(name)
        }

    def trained_runs(self) -> list[Run]:
        """Return the runs with a model that is trained here."""
        return [run for run in self.runs() if run.protocol != recordings.SHIPPED]

    def read_sources(self) -> list[str]:
        """Return the recordings that the runs are trained or scored on."""
        used = {name for run in self.runs() for name in (run.source, *self.used_sources(run))}
        return [name for name in self.sources if name in used]


STREET = "street"
"""First part of the keys of simulated streets."""


def street_key(name: str) -> str:
    """Return the key of a simulated street."""
    return f"{STREET}.{name}"


STAGES = ("ground_removal", "supervoxelise", "features", "patches")
"""Stages whose parameters methods are trained with."""


def plan_study(
    study: recordings.StudyParameters,
    classes: Mapping[str, Any],
    ground_removal: GroundParameters,
    supervoxelise: SupervoxelParameters,
    features: FeatureParameters,
    patches: PatchParameters,
    **methods: Any,
) -> StudyPlan:
    """Return the plan."""
    sources = recordings.sources_of(study.sources)
    codings = {name: source.read_coding(classes["codings"]) for name, source in sources.items()}
    scheme = find_scheme(classes["schemes"], study.scheme)
    stages = dict(zip(STAGES, (ground_removal, supervoxelise, features, patches), strict=True))
    return StudyPlan(study, sources, codings, scheme, {**stages, **method_parameters(methods)})


def read_scenes(plan: StudyPlan) -> dict[str, SceneTask]:
    """Create one task per file of a recording that reads it, and one per street that simulates it."""
    tasks = {}
    trained = any(run.protocol not in (recordings.SHIPPED, recordings.OWN) for run in plan.runs())
    for name, config in plan.streets().items() if trained else ():
        street = {"simulation": simulation_parameters(config), "scan_spacing": config.get("scan_spacing")}
        tasks[street_key(name)] = SceneTask(make_scenes, parameters=street)
    for name in plan.read_sources():
        source = plan.sources[name]
        paths = source.paths(plan.root)
        blocks = [SourceFile(str(path)) for path in paths.values() if source.is_test_block(path)]
        for stem, path in paths.items():
            labels = None if source.labels is None else path.parent / source.labels / f"{stem}.label"
            is_test = source.is_test_block(path)
            files = {
                "path": SourceFile(str(path)),
                "labels": None if labels is None else SourceFile(str(labels)),
                "test_blocks": [] if is_test else blocks,
            }
            parameters = {
                "coding": plan.codings[name],
                "read": dict(source.read),
                "plane": source.plane,
                "pose": source.pose(stem),
                "is_test": is_test,
                "gap": plan.study.gap,
            }
            tasks[f"{name}.{stem}"] = SceneTask(read_scene, files, parameters)
    return tasks


def prepare_scenes(plan: StudyPlan, scenes: SceneCollection) -> dict[str, SceneTask]:
    """Create one task per training scene and kind of preparation."""
    tasks = {}
    for run in plan.trained_runs():
        preparation = preparation_of(run.trained)
        for key in plan.training_scenes(run):
            source = plan.sources.get(key.partition(".")[0])
            parameters = {
                "kind": preparation.kind,
                "stages": preparation.stages(plan.parameters),
                "scheme": plan.scheme,
                "mixed": () if source is None else tuple(source.mixed),
            }
            tasks[f"{preparation.kind}.{key}"] = SceneTask(prepare, {"scenes": scenes[key]}, parameters)
    return tasks


def train_models(plan: StudyPlan, prepared: SceneCollection) -> dict[str, SceneTask]:
    """Create one task per method and training data."""
    tasks = {}
    for run in plan.trained_runs():
        preparation, uses = preparation_of(run.trained), plan.training_scenes(run)
        keys = [f"{preparation.kind}.{key}" for key in uses]
        parameters = {
            "method": run.trained,
            "uses": {f"{preparation.kind}.{key}": (use, *plan.source_of(key)) for key, use in uses.items()},
            "parameters": plan.parameters_of(run.trained),
            "scheme": plan.scheme,
            "trained_on": {"training": plan.training_set(run), "scenes": len(uses)},
        }
        handles = Deferred(tuple(prepared[key] for key in keys))
        tasks[model_key(plan, run)] = SceneTask(train_model, {"prepared": handles}, parameters)
    return tasks


def model_key(plan: StudyPlan, run: Run) -> str:
    """Return the key of the model of a run."""
    return f"{run.trained}.{plan.training_set(run)}"


def score_runs(
    plan: StudyPlan, scenes: SceneCollection, models: SceneCollection, shipped: Mapping[str, ModelBundle]
) -> dict[str, SceneTask]:
    """Create one task per run that labels a recording and scores the labels; `shipped` are the package's models."""
    of_package = {name: model_arrays(bundle) for name, bundle in shipped.items()}
    tasks = {}
    for run in plan.runs():
        source = plan.sources[run.source]
        stems = list(source.paths(plan.root))
        model: Any = of_package[run.method] if run.protocol == recordings.SHIPPED else models[model_key(plan, run)]
        inputs = {"scenes": Deferred(tuple(scenes[f"{run.source}.{stem}"] for stem in stems)), "model": model}
        if run.method == POOL and run.protocol != recordings.SHIPPED:
            inputs["pool"] = of_package[POOL]
        parameters = {
            "scheme": plan.scheme,
            "mixed": {name: tuple(others) for name, others in source.mixed.items()},
            "only_test": run.protocol in (recordings.OWN, recordings.BOTH),
        }
        tasks[run.key] = SceneTask(score_source, inputs, parameters)
    return tasks

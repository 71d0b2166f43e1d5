"""What the study of Luo et al. 2019 runs: its scales, the disturbances, and the settings that are tried."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.jointnet.parameters import VIEWS
from mlsroad_pipeline.algorithms.recognition.disturbances import PAPER_LEVELS, Disturbance
from mlsroad_pipeline.studies.parameters import chosen_scale

JOINTNET, PRINTED = "jointnet", "jointnet_printed"
SUB_NETWORKS = tuple(f"{view}_net" for view in VIEWS)
RIVALS = ("hierarchy_descriptor", "spin_image", "shot", "pointnet")
METHODS = (JOINTNET, PRINTED, *SUB_NETWORKS, *RIVALS)
"""All recognisers; the rivals stand in the order of the paper's Table 2."""

KINDS = ("noise", "keep", "outliers", "occlusion")
"""The disturbances of Figures 12 and 13 in their order; `keep` is the share of the points that down-sampling leaves."""

CLEAN, LABELS, COMBINED = "clean", "labels", "combined"


@dataclass(frozen=True)
class StudyScale:
    """How large the study is.

    Parameters
    ----------
    seeds : sequence of int
        Seeds of the methods; each trains all of them anew, and what they recognise is counted together.
    sizes : sequence of int
        Image sizes of Figure 7, each tried for one kind of image while the others keep theirs (luo2019: 8 to 256). The
        time of an image goes with its square.
    noise, keep, outliers, occlusion : sequence of float
        Levels of test objects in Figure 12.
    training : mapping of str to sequence of float
        Levels of training objects in Figure 13, by kind; ``labels`` are shares of wrong classes (Figure 14c, luo2019:
        1/32 to 8/32).
    combined : sequence of sequence of float
        Noise, share that is kept, outliers and occlusion of training objects in Figures 14a and 14b. The paper names
        the first, (0.01, 0.5, 0.05, 0.05).
    variants : mapping
        What is different in JointNet's parameters for Figures 7, 13 and 14, which take many trainings.
    methods : mapping
        Slug to changes of the method's parameters at this scale.
    tuning : mapping
        Slug to the settings of which the one with the highest accuracy on validation objects is taken. Methods without
        settings here take their parameters, or choose by cross-validation.

    Raises
    ------
    ParameterError
        If a list is empty, a level is out of range, or a method is unknown.
    """

    seeds: Sequence[int]
    sizes: Sequence[int]
    noise: Sequence[float]
    keep: Sequence[float]
    outliers: Sequence[float]
    occlusion: Sequence[float]
    training: Mapping[str, Sequence[float]]
    combined: Sequence[Sequence[float]]
    variants: Mapping[str, Any]
    methods: Mapping[str, Mapping[str, Any]]
    tuning: Mapping[str, Sequence[Mapping[str, Any]]]

    def __post_init__(self) -> None:
        if not self.seeds:
            raise ParameterError("luo2019_study: seeds must not be empty")
        unknown = sorted({*self.methods, *self.tuning} - set(METHODS))
        if unknown:
            raise ParameterError(f"luo2019_study: unknown methods {unknown} (methods: {', '.join(METHODS)})")
        unknown = sorted(set(self.training) - {*KINDS, LABELS})
        if unknown:
            raise ParameterError(f"luo2019_study.training: unknown {unknown} (kinds: {', '.join((*KINDS, LABELS))})")
        for rate in self.training.get(LABELS, ()):
            if not 0 <= rate < 1:
                raise ParameterError(f"luo2019_study.training.labels must be at least 0 and below 1, got {rate!r}")
        self.conditions()
        self.training_conditions()

    def conditions(self) -> dict[str, Disturbance]:
        """Return how test objects are disturbed: name, such as ``noise=0.02``, to disturbance."""
        found = {CLEAN: Disturbance(), **{f"level={i}": level for i, level in enumerate(PAPER_LEVELS, 1)}}
        return found | {f"{kind}={v:g}": Disturbance(**{kind: v}) for kind in KINDS for v in getattr(self, kind)}

    def training_conditions(self) -> dict[str, tuple[Disturbance, float]]:
        """Return how training objects are disturbed: name to disturbance and share of wrong classes."""
        found = {CLEAN: (Disturbance(), 0.0)}
        for kind, levels in self.training.items():
            for v in levels:
                wrong = kind == LABELS
                found[f"{kind}={v:g}"] = (Disturbance() if wrong else Disturbance(**{kind: v}), v if wrong else 0.0)
        for i, values in enumerate(self.combined, 1):
            if len(values) != len(KINDS):
                raise ParameterError(f"luo2019_study.combined must have four numbers each, got {list(values)}")
            found[f"{COMBINED}={i}"] = (Disturbance(**dict(zip(KINDS, values, strict=True))), 0.0)
        return found

    def size_settings(self, sizes: Sequence[int]) -> dict[str, list[int]]:
        """Return the settings of Figure 7."""
        return {
            f"{view}={size}": [size if k == i else int(kept) for k, kept in enumerate(sizes)]
            for i, view in enumerate(VIEWS)
            for size in self.sizes
        }


@dataclass(frozen=True)
class StudyParameters:
    """The study of Luo et al. 2019.

    Parameters
    ----------
    scale : str
        Which of `scales` is run.
    scales : mapping
        Name to the fields of `StudyScale`.
    sydney : str, optional
        Folder of the Sydney Urban Objects, whose folds are recognised too (Tables 2 and 3, Figures 11c and 12i to 12l);
        None leaves them out.
    seed : int
        Seed of the disturbances, which are the same for all methods.

    Raises
    ------
    ParameterError
        If there is no such scale, or its fields are not those of `StudyScale`.
    """

    scale: str
    scales: Mapping[str, Any]
    sydney: str | None
    seed: int

    def __post_init__(self) -> None:
        self.chosen_scale()

    def chosen_scale(self) -> StudyScale:
        """Return the scale that is run."""
        return chosen_scale(StudyScale, "luo2019_study", self.scale, self.scales)


def seeded(parameters: Any, seed: int) -> Any:
    """Return a method's parameters with another seed."""
    if hasattr(parameters, "training"):
        return replace(parameters, training=replace(parameters.training, seed=seed))
    return replace(parameters, seed=seed)

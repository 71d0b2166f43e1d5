"""Parameters of the study of Luo et al. 2019: scales, disturbances and settings to try."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.papers.luo2019.jointnet.parameters import VIEWS
from mlsroad_pipeline.papers.shared.recognition.disturbances import PAPER_LEVELS, Disturbance
from mlsroad_pipeline.papers.shared.studies.parameters import ScaledStudy

JOINTNET, TUNED, PRINTED = "jointnet", "jointnet_tuned", "jointnet_printed"
SUB_NETWORKS = tuple(f"{view}_net" for view in VIEWS)
BASELINES = ("hierarchy_descriptor", "spin_image", "shot", "pointnet")
METHODS = (JOINTNET, TUNED, PRINTED, *SUB_NETWORKS, *BASELINES)
"""All recognisers; the baselines in the order of the paper's Table 2."""

KINDS = ("noise", "keep", "outliers", "occlusion")
"""Disturbances in the order of Figures 12 and 13; `keep` is the share of points kept by down-sampling."""

CLEAN, LABELS, COMBINED = "clean", "labels", "combined"


@dataclass(frozen=True)
class StudyScale:
    """Levels and settings of one scale."""

    # Seeds of the methods. All methods are trained once per seed; the counts of all seeds are summed.
    seeds: Sequence[int]
    # Image sizes of Figure 7, each tried for one kind of image while the others keep theirs (luo2019: 8 to 256).
    # Computing time grows with the square of the size.
    sizes: Sequence[int]
    noise: Sequence[float]  # Levels of test objects in Figure 12
    keep: Sequence[float]  # Levels of test objects in Figure 12
    outliers: Sequence[float]  # Levels of test objects in Figure 12
    occlusion: Sequence[float]  # Levels of test objects in Figure 12
    # Levels of training objects in Figure 13, by kind; ``labels`` are shares of wrong classes (Figure 14c, luo2019:
    # 1/32 to 8/32)
    training: Mapping[str, Sequence[float]]
    # Noise, share of points kept, outliers and occlusion of training objects in Figures 14a and 14b. The paper gives
    # the first, (0.01, 0.5, 0.05, 0.05).
    combined: Sequence[Sequence[float]]
    variants: Mapping[str, Any]  # Changes of JointNet's parameters for Figures 7, 13 and 14, which take many trainings
    # Changes of the parameters of JointNet and its sub-networks for Figures 9 and 10, where images alone are used
    images_alone: Mapping[str, Any]
    # Image sizes of which all combinations for the three kinds of images are tried; empty for none. The paper tries 6 x
    # 6 x 6 = 216 (section 4.2).
    grid: Sequence[int]
    methods: Mapping[str, Mapping[str, Any]]  # Slug to changes of the method's parameters at this scale
    # Slug to the settings to try; the one with the highest accuracy on validation objects is used. Methods without
    # settings here use their parameters or choose by cross-validation.
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
        """Return the disturbances of test objects by name, such as ``noise=0.02``."""
        fixed = {CLEAN: Disturbance(), **{f"level={i}": level for i, level in enumerate(PAPER_LEVELS, 1)}}
        return fixed | {f"{kind}={v:g}": Disturbance(**{kind: v}) for kind in KINDS for v in getattr(self, kind)}

    def training_conditions(self) -> dict[str, tuple[Disturbance, float]]:
        """Return the disturbances of training objects by name, each with its share of wrong classes."""
        conditions = {CLEAN: (Disturbance(), 0.0)}
        for kind, levels in self.training.items():
            for v in levels:
                wrong = kind == LABELS
                conditions[f"{kind}={v:g}"] = (
                    Disturbance() if wrong else Disturbance(**{kind: v}),
                    v if wrong else 0.0,
                )
        for i, values in enumerate(self.combined, 1):
            if len(values) != len(KINDS):
                raise ParameterError(f"luo2019_study.combined must have four numbers each, got {list(values)}")
            conditions[f"{COMBINED}={i}"] = (Disturbance(**dict(zip(KINDS, values, strict=True))), 0.0)
        return conditions

    def size_settings(self, sizes: Sequence[int]) -> dict[str, list[int]]:
        """Return the settings of Figure 7."""
        return {
            f"{view}={size}": [size if k == i else int(kept) for k, kept in enumerate(sizes)]
            for i, view in enumerate(VIEWS)
            for size in self.sizes
        }

    def grid_settings(self) -> dict[str, list[int]]:
        """Return the combinations of image sizes, such as ``sizes=16x8x16``."""
        return {"sizes=" + "x".join(map(str, sizes)): list(sizes) for sizes in product(self.grid, repeat=len(VIEWS))}


@dataclass(frozen=True)
class StudyParameters(ScaledStudy[StudyScale], group="luo2019_study", kind=StudyScale):
    """Parameters of the study of Luo et al. 2019."""

    # Folder of the Sydney Urban Objects, whose folds are also recognised (Tables 2 and 3, Figures 11c and 12i to 12l);
    # None omits them
    sydney: str | None
    seed: int  # Seed of the disturbances, which are the same for all methods


def seeded(parameters: Any, seed: int) -> Any:
    """Return a method's parameters with another seed."""
    if hasattr(parameters, "training"):
        return replace(parameters, training=replace(parameters.training, seed=seed))
    return replace(parameters, seed=seed)

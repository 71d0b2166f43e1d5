"""Scales, surveys, their division and the forests of the study of Tomic et al. 2019, and its tasks."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import cycle
from typing import Any

from mlsroad_pipeline.algorithms.core.classes import ClassScheme, find_scheme
from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.stage_parameters import (
    FeatureParameters,
    GroundParameters,
    StageParameters,
    SupervoxelParameters,
)
from mlsroad_pipeline.algorithms.features.eigen import SHAPE_FEATURES
from mlsroad_pipeline.algorithms.features.normals import ORIENTATION_FEATURES
from mlsroad_pipeline.algorithms.features.supervoxel_moments import (
    GROUND_HEIGHT_FEATURES,
    INTENSITY_FEATURES,
    OWN_HEIGHT_FEATURES,
)
from mlsroad_pipeline.algorithms.models.pool.log_linear import PoolParameters
from mlsroad_pipeline.execution.collection import SceneCollection
from mlsroad_pipeline.execution.task import SceneTask
from mlsroad_pipeline.papers.shared.studies.parameters import ScaledStudy, changed
from mlsroad_pipeline.papers.shared.studies.streets import street_key, street_tasks
from mlsroad_pipeline.papers.tomic2019.detrended_forest.training import ForestParameters
from mlsroad_pipeline.papers.tomic2019.fusion.labeller import FusionParameters
from mlsroad_pipeline.papers.tomic2019.image_labels.training_parameters import ImageLabelsParameters
from mlsroad_pipeline.papers.tomic2019.study import runs
from mlsroad_pipeline.papers.tomic2019.study.runs import Division, ForestVariant
from mlsroad_pipeline.simulation.parameters.presets import simulation_parameters

PAPER_FEATURES = (
    *SHAPE_FEATURES, *ORIENTATION_FEATURES, *OWN_HEIGHT_FEATURES, *GROUND_HEIGHT_FEATURES, *INTENSITY_FEATURES
)  # fmt: skip
"""Features of section 2.1: shape from eigenvalues, height, orientation and radiometry."""

PAPER_COLUMNS = ("intensity", "label")
"""Point attributes that the method of section 2.1 uses; colour is left to the images."""


@dataclass(frozen=True)
class StudyScale:
    """Surveys and settings of one scale."""

    # ``preset`` and changes of `SimulationParameters` of the divided surveys, without the seed
    survey: Mapping[str, Any]
    seeds: Sequence[int]  # Seeds of these surveys; one experiment each
    # The same for the streets whose images train the network; the kinds alternate
    photographs: Sequence[Mapping[str, Any]]
    photograph_seeds: Sequence[int]  # Seeds of the training images; none is in `seeds`
    gap: float = 10.0  # See `Division`
    # Survey whose first half trains the feature-based method: the next survey in the list, or the labelled survey
    # itself. In the paper, training streets and test set 2 are different streets (its Figures 7 and 9).
    train_on: str = "other"
    # ``image_labels``, ``detrended_forest`` or ``fusion`` to changes of their parameters at this scale
    methods: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        every = [*self.seeds, *self.photograph_seeds]
        if not self.photographs:
            raise ParameterError("tomic2019_study.photographs must have at least one kind of street")
        if not self.seeds or not self.photograph_seeds or len(set(every)) < len(every):
            raise ParameterError(
                f"tomic2019_study: seeds and photograph_seeds must be non-empty and distinct, got "
                f"{list(self.seeds)} and {list(self.photograph_seeds)}"
            )
        if self.train_on not in ("other", "same"):
            raise ParameterError(f"tomic2019_study.train_on must be 'other' or 'same', got {self.train_on!r}")
        if any("seed" in survey for survey in (self.survey, *self.photographs)):
            raise ParameterError(
                "tomic2019_study: survey and photographs must not have a seed; use seeds and photograph_seeds"
            )
        if self.train_on == "other" and len(self.seeds) < 2:
            raise ParameterError("tomic2019_study.train_on is 'other', but seeds has one survey; add one or use 'same'")


@dataclass(frozen=True)
class StudyParameters(ScaledStudy[StudyScale], group="tomic2019_study", kind=StudyScale):
    """Parameters of the study of Tomic et al. 2019."""

    # Changes of the parameters of the forest for method 1 as printed in section 2.1
    printed_forest: Mapping[str, Any]
    # Changes of the parameters of the features for method 1 as printed in section 2.1
    printed_features: Mapping[str, Any]
    # Changes of the parameters of the supervoxels for method 1 as printed in section 2.1
    printed_supervoxels: Mapping[str, Any] = field(default_factory=dict)
    # Further changes of the forest for the variants with regularised labels (the paper's second conclusion)
    regularised: Mapping[str, Any] = field(default_factory=dict)


PRINTED, OWN = "printed_forest", "detrended_forest"
"""Method 1 with the features of section 2.1, and with those of this project."""

MAIN = (PRINTED, OWN)
"""Methods 1 of Tables 2 to 5."""

PAPON, PLAIN = "printed_papon", "printed_plain"
SMOOTHED, PLAIN_SMOOTHED = "printed_smoothed", "printed_plain_smoothed"
"""`PRINTED` with the distance of Papon et al. 2013, without detrended features, and either with regularised labels."""

HIDDEN = "hidden_points"
"""Images whose visible points hidden point removal selects; key of their labels and of their fusion with `PRINTED`."""

NETWORK = "network"
"""Key of the trained network."""


@dataclass(frozen=True)
class StudyPlan:
    """Parameters of all stages of the study."""

    study: StudyParameters  # scale, surveys and seeds
    scheme: ClassScheme  # classes
    ground: GroundParameters  # ground filter
    division: Division  # division of the surveys
    forests: Mapping[str, ForestVariant]  # `PRINTED` and `OWN` to method 1
    images: ImageLabelsParameters  # method 2
    pool: PoolParameters  # probabilistic fusion

    @property
    def scale(self) -> StudyScale:
        """Return the scale that is run."""
        return self.study.chosen_scale()

    @property
    def streets(self) -> list[str]:
        """Return the keys of the divided surveys."""
        return [street_key(seed) for seed in self.scale.seeds]

    def surveys(self) -> dict[str, dict[str, Any]]:
        """Return the configuration of each divided survey."""
        return {street_key(seed): {**self.scale.survey, "seed": seed} for seed in self.scale.seeds}

    def photographed(self) -> dict[str, dict[str, Any]]:
        """Return the configuration of each survey whose images train the network."""
        kinds = zip(self.scale.photograph_seeds, cycle(self.scale.photographs), strict=False)
        return {street_key(seed): {**kind, "seed": seed} for seed, kind in kinds}

    def training_street(self, street: str) -> str:
        """Return the survey whose first half trains the forest that labels a survey."""
        if self.scale.train_on == "same":
            return street
        return self.streets[(self.streets.index(street) + 1) % len(self.streets)]


def plan_study(
    study: StudyParameters,
    classes: Mapping[str, Any],
    ground_removal: GroundParameters,
    supervoxelise: SupervoxelParameters,
    features: FeatureParameters,
    detrended_forest: ForestParameters,
    image_labels: ImageLabelsParameters,
    fusion: FusionParameters,
) -> StudyPlan:
    """Return the plan with the changes of the scale."""
    scale = study.chosen_scale()
    scheme = find_scheme(classes["schemes"], "tomic2019")
    length = simulation_parameters(scale.survey).length
    changes = scale.methods
    own = changed(detrended_forest, changes.get("detrended_forest", {}))
    stages = StageParameters(ground_removal, supervoxelise, features)
    forests = {**_printed_variants(study, own, stages), OWN: ForestVariant(own, stages, (*PAPER_COLUMNS, "rgb"))}
    images = changed(image_labels, changes.get("image_labels", {}))
    pool = changed(fusion.pool, changes.get("fusion", {}))
    return StudyPlan(study, scheme, ground_removal, Division(length, scale.gap), forests, images, pool)


def _printed_variants(
    study: StudyParameters, forest: ForestParameters, stages: StageParameters
) -> dict[str, ForestVariant]:
    """Return method 1 as printed, with either distance, with and without detrending and regularised labels."""
    trees = changed(forest, study.printed_forest)
    smooth = changed(trees, study.regularised)
    printed = replace(
        stages,
        features=changed(stages.features, study.printed_features),
        supervoxels=changed(stages.supervoxels, study.printed_supervoxels),
    )
    papon = replace(printed, supervoxels=replace(printed.supervoxels, distance="papon"))
    plain = replace(printed, features=replace(printed.features, detrend=False))
    each = {
        PRINTED: (trees, printed), PAPON: (trees, papon), PLAIN: (trees, plain), SMOOTHED: (smooth, printed),
        PLAIN_SMOOTHED: (smooth, plain),
    }  # fmt: skip
    return {name: ForestVariant(*parts, PAPER_COLUMNS, PAPER_FEATURES) for name, parts in each.items()}


def make_surveys(plan: StudyPlan) -> dict[str, SceneTask]:
    """Create one task per divided survey that simulates it."""
    return street_tasks(runs.make_survey, plan.surveys(), ground=plan.ground)


def make_photographs(plan: StudyPlan) -> dict[str, SceneTask]:
    """Create one task per street that simulates training images of the network."""
    return street_tasks(runs.make_photographs, plan.photographed())


def train_network(plan: StudyPlan, photographs: SceneCollection) -> dict[str, SceneTask]:
    """Create the task that trains the network."""
    images = photographs.part("images")
    return {
        NETWORK: SceneTask(
            runs.train_network,
            {"photographs": {key: images[key] for key in images}},
            {"parameters": plan.images, "scheme": plan.scheme},
        )
    }


def label_by_features(plan: StudyPlan, streets: SceneCollection) -> dict[str, SceneTask]:
    """Create one task per forest and survey: train on one half, label the other half."""
    points = streets.part("points")
    return {
        f"{name}.{street}": SceneTask(
            runs.train_and_label,
            {"points": points[street], "training": points[plan.training_street(street)]},
            {"variant": variant, "division": plan.division, "scheme": plan.scheme},
        )
        for name, variant in plan.forests.items()
        for street in plan.streets
    }


def label_by_images(plan: StudyPlan, streets: SceneCollection, networks: SceneCollection) -> dict[str, SceneTask]:
    """Create one task per survey and method of visibility that labels its test half through images."""
    points, images = streets.part("points"), streets.part("images")
    weights = networks.part("weights")[NETWORK]
    hidden = replace(plan.images, visibility="hidden_points")
    return {
        f"{prefix}{street}": SceneTask(
            runs.label_by_images,
            {"points": points[street], "images": images[street], "network": weights},
            {"parameters": parameters, "division": plan.division, "scheme": plan.scheme},
        )
        for prefix, parameters in (("", plan.images), (f"{HIDDEN}.", hidden))
        for street in plan.streets
    }


def fuse_surveys(
    plan: StudyPlan, streets: SceneCollection, features: SceneCollection, images: SceneCollection
) -> dict[str, SceneTask]:
    """Create one task per forest and survey that fuses its labels with those of the images."""
    points, by_features, by_images = streets.part("points"), features.part("labels"), images.part("labels")
    pairs = {name: (name, "") for name in plan.forests} | {HIDDEN: (PRINTED, f"{HIDDEN}.")}
    return {
        f"{name}.{street}": SceneTask(
            runs.fuse_survey,
            {
                "points": points[street],
                "features": by_features[f"{forest}.{street}"],
                "images": by_images[f"{prefix}{street}"],
            },
            {"division": plan.division, "scheme": plan.scheme, "pool": plan.pool},
        )
        for name, (forest, prefix) in pairs.items()
        for street in plan.streets
    }

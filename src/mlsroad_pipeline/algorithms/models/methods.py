"""Table of methods: slug to task, parameters, training and use.

Classes and functions are named by strings and imported on use: a command loads only the methods that it needs, and
modules below the methods may read the table.
"""

from dataclasses import dataclass
from importlib import import_module
from typing import Any, Literal

PACKAGE = "mlsroad_pipeline"
"""Package below which methods lie: those of the product in `algorithms`, those of the papers in `papers`."""

Task = Literal["labelling", "detection", "recognition"]

_SHARED: dict[Task, dict[str, str]] = {
    "labelling": {
        "train": "papers.shared.patches.models:train",
        "label_cloud": "papers.shared.patches.models:label_cloud",
    },
    "detection": {
        "train": "papers.shared.detection.training:train_object_detector",
        "label_cloud": "papers.shared.detection.detector:label_cloud",
    },
    "recognition": {
        "train": "papers.shared.recognition.recogniser:train_recogniser",
        "label_cloud": "papers.shared.recognition.recogniser:label_cloud",
    },
}
"""Parts that methods without their own share, by task; those of labelling are of methods that label patches."""


@dataclass(frozen=True)
class Method:
    """A method, with the places ``module:name`` of its parts.

    A module with a leading dot lies in the method's folder, any other below `PACKAGE`.

    Parameters
    ----------
    slug : str
        Name of the pipeline, the catalog entries, the scores and the registered model.
    task : str
        ``labelling`` (of points), ``detection`` or ``recognition`` (of objects).
    folder : str
        Package of the method.
    parameters : str
        Class of the parameters; none of a composed method.
    use : str
        Applies a model. Patch labellers: the classifier class. Other labellers: the function that labels a prepared
        scene. Detectors and recognisers: their class. None of a composed method.
    train : str, optional
        Function that trains a model; by default the one that patch labellers, detectors or recognisers share.
    label_cloud : str, optional
        Function that labels a cloud from raw coordinates on: ``(cloud, bundle)`` to labels and confidences. By default
        the one that patch labellers, detectors or recognisers share. Not called where there is `label_softly`.
    label_softly : str, optional
        Function that labels a cloud and returns class probabilities too: see `labelling.SoftLabels`.
    group : str, optional
        Parameter group in the configuration; the slug by default.
    needs_images : bool, default False
        Whether models need the images of a survey beside its points.
    uses_intensity : bool, default False
        Whether a detector or recogniser takes the intensities of an object, where there are any.
    variant : str, optional
        Images that a sub-network of JointNet takes.
    describe : str, optional
        Function that describes objects for a detector.
    description : str, optional
        Attribute of a detector's parameters that `describe` takes.
    described : str, default "parts"
        Catalog name of the described objects.
    refines : str, optional
        Method whose labels this one refines; it is trained first.
    context : float, default 0.0
        Distance beyond the buffers of a scene up to which points improve its labels, metres.
    composed : bool, default False
        Whether models consist of trained models of other methods, so that there is no training of its own.
    """

    slug: str
    task: Task
    folder: str
    parameters: str = ""
    use: str = ""
    train: str = ""
    label_cloud: str = ""
    label_softly: str = ""
    group: str = ""
    needs_images: bool = False
    uses_intensity: bool = False
    variant: str = ""
    describe: str = ""
    description: str = ""
    described: str = "parts"
    refines: str = ""
    context: float = 0.0
    composed: bool = False

    def function(self, place: str) -> Any:
        """Import a further function ``.module:name`` of the method's folder."""
        return load_place(f"{PACKAGE}.{self.folder}{place}")

    def place(self, part: str) -> str:
        """Return the full place ``"module:name"`` of a part, such as ``"train"``."""
        module, name = (getattr(self, part) or _SHARED[self.task][part]).split(":")
        package = f"{PACKAGE}.{self.folder}" if module.startswith(".") else f"{PACKAGE}."
        return f"{package}{module}:{name}"

    def load(self, part: str) -> Any:
        """Import a part, such as ``"train"``."""
        return load_place(self.place(part))


def load_place(place: str) -> Any:
    """Import the class or function of ``"module:name"``."""
    module, name = place.split(":")
    return getattr(import_module(module), name)


_JOINTNET: dict[str, Any] = {
    "task": "recognition", "folder": "papers.luo2019.jointnet", "parameters": ".parameters:JointNetParameters",
    "use": ".recogniser:JointNetRecogniser", "uses_intensity": True,
}  # fmt: skip
_DESCRIPTORS = "papers.shared.recognition.descriptor_machine:DescriptorParameters"
_PARTS = "papers.shared.detection.regions:describe_parts"

_TABLE = (
    Method(
        "detrended_forest", "labelling", "papers.tomic2019.detrended_forest",
        ".training:ForestParameters", ".labeller:label_scene",
        ".training:fit", ".labeller:label_cloud",
    ),
    Method(
        "patch_graph", "labelling", "papers.luo2016.patch_graph", ".classifier:PatchGraphParameters",
        ".classifier:PatchGraphClassifier",
    ),
    Method(
        "patch_graph_mrf", "labelling", "papers.luo2016.patch_graph", ".refined_classifier:GridParameters",
        ".refined_classifier:RefinedPatchGraphClassifier", ".refined_classifier:train_refinement",
        refines="patch_graph",
    ),
    Method(
        "patch_graph_printed", "labelling", "papers.luo2016.patch_graph", ".classifier:PatchGraphParameters",
        ".classifier:PatchGraphClassifier",
    ),
    Method(
        "patch_graph_mrf_printed", "labelling", "papers.luo2016.patch_graph", ".refined_classifier:GridParameters",
        ".refined_classifier:RefinedPatchGraphClassifier", ".refined_classifier:train_refinement",
        refines="patch_graph_printed",
    ),
    Method(
        "patch_svm", "labelling", "papers.luo2016.patch_svm", ".classifier:PatchSvmParameters", ".classifier:PatchSvm"
    ),
    Method(
        "patch_forest", "labelling", "papers.luo2016.patch_forest", ".classifier:PatchForestParameters",
        ".classifier:PatchForest",
    ),
    Method(
        "shape_based", "labelling", "papers.luo2016.shape_based",
        ".labeller:ShapeParameters", ".labeller:label_objects",
        ".labeller:fit", ".labeller:label_cloud",
    ),
    Method(
        "max_margin_markov", "labelling", "papers.luo2016.max_margin_markov", ".classifier:MarginParameters",
        ".classifier:MaxMarginMarkov",
    ),
    Method(
        "superpoint_transformer", "labelling", "algorithms.models.superpoint_transformer",
        ".parameters:SuperpointTransformerParameters", ".labeller:label_scene", ".training:fit",
        label_softly=".labeller:label_cloud_softly", context=15.0,
    ),
    Method(
        "boosted_trees", "labelling", "algorithms.models.boosted_trees", ".parameters:BoostedTreesParameters",
        ".labeller:label_scene", ".training:fit", label_softly=".labeller:label_cloud_softly",
    ),
    Method(
        "image_labels", "labelling", "papers.tomic2019.image_labels", ".training_parameters:ImageLabelsParameters",
        ".labeller:label_scene", ".labeller:fit", "algorithms.models.bundle:refuse_points", needs_images=True,
    ),
    Method(
        "fusion", "labelling", "papers.tomic2019.fusion",
        ".labeller:FusionParameters", ".labeller:fuse_scene", ".labeller:fit",
        "algorithms.models.bundle:refuse_points", needs_images=True,
    ),
    *(
        Method(
            slug, "detection", "papers.yu2016.visual_words", ".training:VisualWordsParameters",
            ".training:VisualWords", ".training:train_detector", describe=".groups:describe_objects",
            description="groups", described="groups",
        )
        for slug in ("visual_words", "visual_words_printed")
    ),
    Method(
        "hough_forest", "detection", "papers.yu2016.hough_forest", ".detector:HoughForestParameters",
        ".detector:HoughForest", describe=_PARTS, description="regions", uses_intensity=True,
    ),
    Method(
        "object_matching", "detection", "papers.yu2016.object_matching", ".detector:ObjectMatchingParameters",
        ".detector:ObjectMatcher", describe=_PARTS, description="regions", uses_intensity=True,
    ),
    Method(
        "bottom_up_top_down", "detection", "papers.yu2016.bottom_up_top_down", ".detector:BottomUpTopDownParameters",
        ".detector:BottomUpTopDown", describe=".oriented_points:describe_surfaces", description="surfaces",
    ),
    *(Method(slug, **_JOINTNET) for slug in ("jointnet", "jointnet_tuned", "jointnet_printed")),
    *(Method(f"{view}_net", **_JOINTNET, group="jointnet", variant=view) for view in ("hssi", "vqai", "vaai")),
    *(
        Method(slug, "recognition", "papers.luo2019.descriptors", _DESCRIPTORS, f".recognisers:{kind}Recogniser")
        for slug, kind in (("spin_image", "SpinImage"), ("shot", "Shot"), ("hierarchy_descriptor", "Hierarchy"))
    ),
    Method(
        "pointnet", "recognition", "papers.luo2019.pointnet", ".parameters:PointNetParameters",
        ".recogniser:PointNetRecogniser",
    ),
    Method(
        "pool", "labelling", "algorithms.models.pool", label_softly=".labeller:label_cloud_softly", composed=True
    ),
    Method(
        "corrected", "labelling", "algorithms.models.boosted_trees", label_softly=".corrected:label_cloud_softly",
        composed=True,
    ),
    Method(
        "given_labels", "labelling", "algorithms.models.given_labels", label_softly=".labeller:label_cloud_softly",
        composed=True,
    ),
)  # fmt: skip

METHODS = {method.slug: method for method in _TABLE}
"""Slug to method; the order is that of the tables of scores."""


def trained_methods() -> dict[str, Method]:
    """Return the methods with a training and a pipeline of their own, by slug."""
    return {slug: method for slug, method in METHODS.items() if not method.composed}


def methods_of(task: Task, *, needs_images: bool = False) -> tuple[str, ...]:
    """Return the slugs of the methods of a task that have a training of their own, with or without need of images."""
    return tuple(
        slug for slug, method in trained_methods().items() if (method.task, method.needs_images) == (task, needs_images)
    )


def needs_images(slug: str) -> bool:
    """Return whether models of a method need images; false for methods that are not in the table."""
    return slug in METHODS and METHODS[slug].needs_images

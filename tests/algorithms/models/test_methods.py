"""Table of methods."""

import dataclasses
import subprocess
import sys

import numpy as np
import pytest

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.models.labelling import label_cloud
from mlsroad_pipeline.algorithms.models.methods import METHODS, methods_of, needs_images, trained_methods

PLACES = ("parameters", "use", "train")
COMPOSED = ("pool", "corrected", "given_labels")


@pytest.mark.parametrize("slug", COMPOSED)
def test_a_composed_method_has_functions_that_label_and_no_training(slug):
    method = METHODS[slug]
    assert method.composed and method.task == "labelling" and slug not in methods_of("labelling")
    assert callable(method.load("label_softly"))


@pytest.mark.parametrize("slug", trained_methods())
def test_all_places_of_a_method_exist(slug):
    method = METHODS[slug]
    parameters, use, train = (method.load(part) for part in PLACES)
    label = "label_softly" if method.label_softly else "label_cloud"
    assert method.slug == slug
    assert dataclasses.is_dataclass(parameters)
    assert all(map(callable, (use, train, method.load(label))))
    assert method.place(label).startswith("mlsroad_pipeline.")
    if method.task == "detection":
        assert callable(method.load("describe"))
        assert hasattr(parameters(), method.description)


def test_tasks_divide_the_table_in_its_order():
    groups = [methods_of("labelling"), methods_of("labelling", needs_images=True)]
    groups += [methods_of("detection"), methods_of("recognition")]
    assert [slug for group in groups for slug in group] == list(trained_methods()) == list(METHODS)[: -len(COMPOSED)]
    assert groups[1] == ("image_labels", "fusion")
    assert [slug for slug in METHODS if needs_images(slug)] == list(groups[1])
    assert not needs_images("unknown")


def test_the_table_imports_no_method():
    script = "import sys, mlsroad_pipeline.algorithms.models.bundle; print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout.split()
    folders = {f"mlsroad_pipeline.{method.folder}" for method in METHODS.values()}
    assert not folders & set(loaded)
    assert not {"torch", "numba", "sklearn", "scipy"} & set(loaded)


@pytest.mark.parametrize("slug", ["image_labels", "fusion"])
def test_models_that_need_images_refuse_points_alone(slug):
    cloud = PointCloud(np.zeros((1, 3)), source="street.laz")
    with pytest.raises(ParameterError, match=f"street.laz: model '{slug}' needs images; it cannot label points alone"):
        label_cloud(ModelBundle(slug, {}, {"classes": ["road"]}), cloud)

"""Fixtures of the tests of `label`: a project with registered models, and a part of a street they were not trained on."""

import pytest
from helpers.labelled import N_POINTS
from helpers.wiring import label, shared_run, with_models

from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.formats.base import ReadOptions, WriteOptions
from mlsroad_pipeline.formats.las.format import LasFormat


@pytest.fixture(scope="module")
def shared(tmp_path_factory):
    return shared_run(tmp_path_factory)


@pytest.fixture(scope="module")
def label_project(shared, tmp_path_factory):
    return with_models(shared, tmp_path_factory.mktemp("labelling"))


@pytest.fixture(scope="module")
def cloud(shared):
    """The first points of a survey that the model was not trained on, with colour, intensity and time but no labels."""
    path = shared / "data/01_raw/simulated/test/survey.laz"
    found = LasFormat().read(path, ReadOptions(only=("rgb", "intensity", "gps_time", "scanner")), stop=N_POINTS)
    return PointCloud(found.xyz, found.columns, found.origin, found.crs, "cut")


@pytest.fixture(scope="module")
def survey(cloud, tmp_path_factory):
    """The same points as LAZ."""
    path = tmp_path_factory.mktemp("survey") / "street.laz"
    LasFormat().write(path, cloud, WriteOptions(like="none"))
    return path


@pytest.fixture(scope="module")
def labelled(label_project, survey, tmp_path_factory):
    """The survey, labelled once."""
    return label(label_project, survey, tmp_path_factory.mktemp("out") / "new" / "folder")

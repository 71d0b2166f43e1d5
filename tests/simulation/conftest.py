"""One small survey for all tests of the simulator."""

from dataclasses import replace

import pytest

from mlsroad_pipeline.simulation import PRESETS, SurveyStream, simulate_survey

PARAMETERS = replace(PRESETS["tiny"], seed=5)


@pytest.fixture(scope="session")
def parameters():
    """Parameters of the survey."""
    return PARAMETERS


@pytest.fixture(scope="session")
def survey():
    """A simulated survey."""
    return simulate_survey(PARAMETERS)


@pytest.fixture(scope="session")
def stream():
    """The same survey as a stream."""
    return SurveyStream(PARAMETERS)


@pytest.fixture(scope="session")
def scene(stream):
    """Scene of its first block."""
    return stream.scene(0)


@pytest.fixture(scope="session")
def photographs(stream, scene):
    """Images of the first block with depths."""
    taken = [stream.shoot(scene, moment) for moment in stream.moments(0)]
    return [image for images, _ in taken for image in images], [depth for _, depths in taken for depth in depths]

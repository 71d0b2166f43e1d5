"""Descriptions of registered models."""

import pytest
from helpers.wiring import REPOSITORY

from mlsroad_pipeline.algorithms.models.methods import trained_methods
from mlsroad_pipeline.model_store.registration import manual_page


@pytest.mark.parametrize("slug", trained_methods())
def test_the_page_of_every_trained_method_is_in_the_manual_and_names_it(slug):
    assert slug in (REPOSITORY / manual_page(slug)).read_text(encoding="utf-8")

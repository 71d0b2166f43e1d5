"""Names of class codes on the page, for results with LAS codes and with codes from 64."""

from pathlib import Path
from types import SimpleNamespace

import pytest
from helpers.labelled import scheme

from mlsroad_pipeline.review.page_server.output_folder import OutputFolder


@pytest.mark.parametrize(("written", "name"), [("asprs", "pole"), ("road_inventory", "paved ground")])
def test_codes_have_the_names_of_the_scheme_that_was_written(written, name):
    settings = {"label": {"scheme": written}, "classes": {"schemes": {"road_inventory": scheme()}}}
    folder = OutputFolder(Path("out"), {"settings": settings, "summary": {"classes": {"pole": 3}}})
    in_files = {9: "water", 64: "paved ground" if written != "asprs" else "pol"}
    folder.__dict__["clouds"] = SimpleNamespace(class_names=lambda: in_files)
    names = folder.class_names()
    assert (names[9], names[64]) == ("water", name) and (66 in names) == (written == "asprs")

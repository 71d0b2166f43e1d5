"""Report: one self-contained file with all inputs escaped."""

import base64
import io
import re
from html.parser import HTMLParser

import numpy as np
import pandas as pd
import pytest
from PIL import Image

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.palette import COLOURS
from mlsroad_pipeline.reporting.figures import oob_figure
from mlsroad_pipeline.reporting.html.objects import object_table_section
from mlsroad_pipeline.reporting.html.report import (
    build_report,
    data_uri,
    distribution_section,
    facts_section,
    figure_pixels,
    figures_section,
    gallery_section,
    table_section,
    warnings_section,
)

EVIL = "<script>alert('x')</script>\"&"
VOID = {"meta", "img", "br"}


class Balance(HTMLParser):
    """Note every tag and whether each one that opens closes in order."""

    def __init__(self):
        super().__init__()
        self.open, self.seen, self.addresses = [], [], []

    def handle_starttag(self, tag, attrs):
        self.seen.append(tag)
        self.addresses += [value for name, value in attrs if name in ("src", "href")]
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


@pytest.fixture
def sections():
    objects = pd.DataFrame({"class": ["pole", "car", EVIL], "x": [431234.125, 2.0, np.nan], "points": [12345, 2, 3]})
    return [
        facts_section(EVIL, {EVIL: EVIL, "points": 1234567, "crs": None}),
        table_section("Quality", pd.DataFrame({EVIL: [EVIL, "b"], "density": [np.nan, 12.34567]}), EVIL),
        figures_section("Figures", {EVIL: np.zeros((3, 5, 3), np.uint8), "curve": oob_figure([1, 2], [0.2, 0.1])}),
        distribution_section("Classes", {"car": 30, EVIL: 10}),
        table_section("Objects", objects),
        warnings_section("Warnings", [EVIL]),
    ]


def test_report_is_well_formed_and_loads_nothing(sections):
    page = build_report(sections, title=EVIL, subtitle=EVIL)
    parser = Balance()
    parser.feed(page)
    parser.close()
    assert parser.open == []
    assert "script" not in parser.seen
    assert "link" not in parser.seen
    outside = [a for a in parser.addresses if not a.startswith(("#", "data:image/webp;base64,"))]
    assert outside == []
    assert "@import" not in page
    assert "url(" not in page


def test_nothing_foreign_reaches_the_page_unescaped(sections):
    page = build_report(sections, title=EVIL, subtitle=EVIL)
    assert "<script>" not in page
    assert page.count("&lt;script&gt;") >= 10


def test_numbers_are_for_people_and_undefined_ones_are_dashes(sections):
    page = build_report(sections)
    assert "<dd>1\u202f234\u202f567</dd>" in page
    assert "<dt>crs</dt><dd>–</dd>" in page
    assert '<td class="number">12.35</td>' in page
    assert '<td class="number">431\u202f234.12</td>' in page


def test_distribution_has_shares_and_the_colours_of_the_pictures(sections):
    body = sections[3].body
    assert "75.00 %" in body
    assert f"background:{COLOURS['car']}" in body
    scheme = ClassScheme("s", ("stuff",), (("bin",),), (), (1,))
    assert (
        f"background:{COLOURS['bin']}" in distribution_section("t", {"stuff": 1, "unlabelled": 2}, scheme=scheme).body
    )


def test_an_empty_survey_still_gives_a_report():
    page = build_report(
        [
            table_section("Quality", pd.DataFrame()),
            distribution_section("Classes", {"car": 0}),
            gallery_section("Objects", {"pole": []}),
            warnings_section("Warnings", []),
        ]
    )
    assert page.count('class="none"') == 3
    assert "0.00 %" in page


def test_a_long_table_says_what_it_leaves_out():
    body = table_section("t", pd.DataFrame({"a": range(10)}), largest=4).body
    assert "6 more rows are omitted" in body
    assert body.count("<tr>") == 5


def test_a_named_index_becomes_columns():
    frame = pd.DataFrame({"value": [1.0]}, index=pd.MultiIndex.from_tuples([("m", "test")], names=["method", "split"]))
    assert "<td>m</td><td>test</td>" in table_section("t", frame).body


@pytest.mark.parametrize(
    ("address", "linked"),
    [("a/b.gpkg", True), ("https://host/b.gpkg", True), ("javascript:alert(1)", False), ("data:text/html,x", False)],
)
def test_only_files_and_web_addresses_become_links(address, linked):
    empty = pd.DataFrame({"kind": [], "objects": []})
    section = object_table_section("i", empty, empty, {"kind": "Kind"}, np.zeros((0, 2)), address)
    assert ("<a href" in section.body) == linked


def test_pictures_are_embedded_as_they_look():
    picture = np.zeros((60, 90, 3), np.uint8)
    picture[:, 30:60], picture[20:40, 60:] = (31, 78, 150), 255
    address = data_uri(picture)
    content = base64.b64decode(re.fullmatch(r"data:image/webp;base64,(.*)", address)[1])
    shown = np.asarray(Image.open(io.BytesIO(content)).convert("RGB")).astype(int)
    assert shown.shape == picture.shape
    assert np.abs(shown - picture).mean() < 3
    assert np.abs(shown[:, 5:25] - picture[:, 5:25]).max() < 8 and np.abs(shown[:, 35:55] - picture[:, 35:55]).max() < 8
    assert data_uri(picture) == address


def test_figures_are_drawn_at_their_own_resolution():
    figure = oob_figure([1, 2], [0.2, 0.1])
    height, width, _ = figure_pixels(figure).shape
    assert (width, height) == tuple(round(side * figure.dpi) for side in figure.get_size_inches())


def test_what_is_no_picture_is_named():
    with pytest.raises(DataError, match=r"uint8 of shape \(height, width, 3\), got float64 \(2, 2\)"):
        data_uri(np.zeros((2, 2)))

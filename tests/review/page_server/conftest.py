"""Small survey, its server, and the page of a shared browser, for each module of tests."""

import pytest
from helpers.browser import browser_page
from helpers.page_output import served, write_output
from helpers.page_tab import READY, errors, reload, settle

from mlsroad_pipeline.review.corrections import open_corrections


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    place = tmp_path_factory.mktemp("says") / "out"
    write_output(place)
    return place


@pytest.fixture(scope="module")
def options():
    """Options of `mlsroad open`; a module may have its own."""
    return ()


@pytest.fixture(scope="module")
def server(folder, options):
    with served(folder, *options) as server:
        yield server


@pytest.fixture(scope="session")
def browser(tmp_path_factory):
    """One browser for all modules: its start and its first picture take as long as five tests."""
    with browser_page(tmp_path_factory.mktemp("chromium")) as tab:
        yield tab


@pytest.fixture(scope="module")
def opened(server, browser):
    browser.open(server.address, width=1200, height=800)
    browser.until(READY)
    browser.until("page.model.queued && page.model.counted")
    settle(browser)
    yield browser
    browser.open("about:blank")  # no request reaches a server that has ended


@pytest.fixture
def tab(opened, folder, server):
    """The tab, without decisions."""
    with open_corrections(folder) as store:
        for decision in store.current():
            store.undo(decision.identifier, who="test")
    opened.js("sessionStorage.clear()")
    reload(opened, server)
    yield opened
    assert errors(opened) == ([], [])

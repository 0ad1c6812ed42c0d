"""A browser that all tests of pages share: it takes longer to start than to open a page."""

import pytest


@pytest.fixture(scope="session")
def started_browser():
    from validation.browser import MISSING, Browser, find_chromium  # which few tests load

    if find_chromium() is None:
        pytest.skip(MISSING)
    with Browser() as started:
        yield started


@pytest.fixture
def browser(started_browser):
    """Return the browser, without what earlier pages asked for and reported."""
    started_browser.requests.clear()
    started_browser.problems.clear()
    return started_browser

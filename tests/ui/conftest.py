from __future__ import annotations

from collections.abc import Iterator

import pytest

pytest.importorskip("playwright", reason="Playwright is not installed")

from playwright.sync_api import Browser, sync_playwright

from .panel import CHROMIUM, HAND, PHONE, Panel, launched


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if "tests/ui" in item.path.as_posix():
            item.add_marker(pytest.mark.ui)
            if CHROMIUM is None:
                item.add_marker(pytest.mark.skip(reason="Chromium is not here"))


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with sync_playwright() as playwright:
        opened = launched(playwright)
        yield opened
        opened.close()


@pytest.fixture
def desk(browser: Browser) -> Iterator[Panel]:
    panel = Panel(browser)
    yield panel
    panel.close()


@pytest.fixture
def phone(browser: Browser) -> Iterator[Panel]:
    panel = Panel(browser, PHONE)
    yield panel
    panel.close()


@pytest.fixture
def hand(browser: Browser) -> Iterator[Panel]:
    panel = Panel(browser, HAND)
    yield panel
    panel.close()

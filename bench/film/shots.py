"""The browser that looks at the panel: rooms at two sizes, and a calibration as it goes."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from playwright.sync_api import Browser, Page, sync_playwright

from bench.film.sheet import Frame

PHONE = {"width": 390, "height": 844}
DESK = {"width": 1280, "height": 860}
FLAGS = ["--no-sandbox", "--disable-dev-shm-usage", "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1"]
LOOK_S = 0.25
WITHIN_S = 400.0
SEEN = """() => [document.querySelector('.job-head .badge')?.textContent,
    document.querySelector('.prompt .say')?.textContent,
    document.querySelectorAll('.faces .done').length, document.querySelector('.prompt.stable') !== null,
    Math.round((document.querySelector('[role=progressbar]')?.ariaValueNow ?? 0) / 12)]"""
"""What must change before another frame is taken."""


@dataclass(frozen=True)
class Camera:
    """A browser, and the address of the panel."""

    browser: Browser
    url: str

    @contextmanager
    def page(self, size: dict[str, int], place: str = "") -> Iterator[Page]:
        """A page of this size that shows this place."""
        context = self.browser.new_context(viewport=size)  # type: ignore[arg-type]
        try:
            page = context.new_page()
            page.goto(f"{self.url}{place}")
            yield page
        finally:
            context.close()

    def room(self, place: str, ready: str, size: dict[str, int], *, whole: bool = False, there: bool = False) -> bytes:
        """A PNG of a room once `ready`, a selector, is there; of its top, or with `there` of that place."""
        with self.page(size, place) as page:
            page.wait_for_selector(ready, timeout=60_000)
            if there:
                page.wait_for_timeout(15_000)  # charts have something to show
                page.locator(ready).first.evaluate("it => it.scrollIntoView({block: 'center'})")
            page.wait_for_timeout(2500)  # pictures are drawn, bars have moved
            return page.screenshot(full_page=whole)

    def calibration(self, sensor: str, in_review: Callable[[str], None]) -> list[Frame]:
        """Frames of a calibration at phone size, from its tile to its proof; `in_review` gets the job's place first."""
        frames: list[Frame] = []
        with self.page(PHONE) as page:
            tile = page.locator(f'button[aria-label$=": {sensor}"]').first
            tile.scroll_into_view_if_needed(timeout=60_000)
            began = time.monotonic()
            frames.append(Frame(0.0, page.screenshot(), ("home",)))
            tile.click()
            page.wait_for_selector(".prompt")
            self._watched(page, began, frames, "Ready for your review")
            paused = time.monotonic()
            in_review(str(page.evaluate("location.hash")))
            began += time.monotonic() - paused
            page.locator(".dock button.primary").click()
            self._watched(page, began, frames, "Done")
        return frames

    def _watched(self, page: Page, began: float, frames: list[Frame], end: str) -> None:
        limit = time.monotonic() + WITHIN_S
        while True:
            about = tuple(page.evaluate(SEEN))
            over = end in str(about[0])
            if over:
                page.wait_for_timeout(2000)
            if over or about != frames[-1].about:
                frames.append(Frame(time.monotonic() - began, page.screenshot(), about))
            if over:
                return
            if time.monotonic() > limit or any(word in str(about[0]) for word in ("Failed", "Cancelled")):
                raise RuntimeError(f"the calibration did not come to '{end}': {about}")
            page.wait_for_timeout(1000 * LOOK_S)


@contextmanager
def camera(url: str) -> Iterator[Camera]:
    """A headless Chromium (Debian's) without a network.

    Raises
    ------
    RuntimeError
        If there is none.
    """
    path = next((p for n in ("chromium", "chromium-browser", "google-chrome") if (p := shutil.which(n))), None)
    if path is None:
        raise RuntimeError("Chromium is not here")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=FLAGS)
        try:
            yield Camera(browser, url)
        finally:
            browser.close()

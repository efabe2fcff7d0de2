"""The panel in a headless Chromium (Debian's, driven by Playwright) against a running service."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from urllib.parse import quote

from playwright.sync_api import Browser, Locator, Page, Playwright, expect

from tests.patience import patience, scaled

CHROMIUM = next((p for n in ("chromium", "chromium-browser", "google-chrome") if (p := shutil.which(n))), None)
FLAGS = ["--no-sandbox", "--disable-dev-shm-usage", "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1"]
PHONE = {"width": 360, "height": 740}
HAND = {"width": 390, "height": 844}
"""The phone of somebody who holds a vehicle; a whole step fits on it without scrolling."""
DESK = {"width": 1280, "height": 860}
KEPT = {"parameters": {"INS_GYR_CAL": 0}, "thermal": False}
"""A vehicle that keeps what is written to its gyros."""
SLOWLY = """(() => {
  window.requestAnimationFrame = (draw) => setTimeout(() => draw(performance.now()), 100);
  window.cancelAnimationFrame = (frame) => clearTimeout(frame);
})()"""
"""Ten pictures a second: a processor draws them here, and nobody looks at sixty."""
NOISE = ("GPU stall", "navigator.vibrate", "AudioContext")
"""What Chromium says of its own drawing, and of a phone that nobody has touched yet."""


def sim(autopilot: str = "ardupilot", *, config: dict[str, object] | None = None, **options: object) -> str:
    """The endpoint of a simulated vehicle that obeys; fast, since nobody has to read its prompts."""
    given: dict[str, object] = {"seed": 3, "speed": 8, **options}
    if config is not None:
        given["config"] = json.dumps(config)
    return f"sim:{autopilot}?" + "&".join(f"{name}={quote(str(value))}" for name, value in given.items())


@contextmanager
def service(folder: Path, *arguments: str, port: int = 0, **environment: str) -> Iterator[str]:
    """A running service: its address. Its log is checked for tracebacks when it has ended."""
    command = [sys.executable, "-m", "mavcal", "serve", "--json", "--port", str(port)]
    command += ["--data-dir", str(folder / "data"), *arguments]
    log_path = folder / "service.log"
    with log_path.open("a") as log:
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=log, env={**os.environ, **environment})
        try:
            assert process.stdout is not None
            line = process.stdout.readline()
            assert line, log_path.read_text()
            yield str(json.loads(line)["url"])
        finally:
            process.terminate()
            process.wait(scaled(20))
            assert process.stdout is not None
            process.stdout.close()
    assert "Traceback" not in log_path.read_text(), log_path.read_text()


def launched(playwright: Playwright) -> Browser:
    """A browser without a network."""
    return playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)


class Panel:
    """One page, which collects what its console complains of."""

    def __init__(self, browser: Browser, size: dict[str, int] = DESK) -> None:
        self.context = browser.new_context(viewport=size)  # type: ignore[arg-type]
        self.context.set_default_timeout(1000 * scaled(20))
        expect.set_options(timeout=1000 * scaled(20))
        self.context.add_init_script(SLOWLY)
        self.page: Page = self.context.new_page()
        self.complaints: list[str] = []
        self.asked: list[str] = []
        self.page.on("console", lambda m: self._said(m.type, m.text, m.location.get("url", "")))
        self.page.on("pageerror", lambda e: self.complaints.append(str(e)))
        self.page.on("request", lambda r: self.asked.append(r.url))

    def _said(self, kind: str, text: str, about: str) -> None:
        if kind in {"error", "warning"} and not any(known in text for known in NOISE):
            self.complaints.append(f"{about}: {text}")

    def open(self, url: str, place: str = "") -> None:
        self.page.goto(f"{url}{place}")

    def sees(self, text: str, seconds: float = 30.0, inside: str = "body") -> None:
        """Wait until the text can be read."""
        expect(self.page.locator(inside).first).to_contain_text(text, timeout=1000 * scaled(seconds))

    def press(self, name: str) -> None:
        """Press the button of that name, where it is and when it can be pressed."""
        self.page.get_by_role("button", name=name, exact=True).first.click()

    def calibrate(self, name: str) -> Locator:
        """The button of a sensor's tile; the first one, where there are several vehicles."""
        return self.page.get_by_role("button", name=re.compile(f"^Calibrate, about .*: {name}$")).first

    def text(self, selector: str) -> str:
        return self.page.locator(selector).first.inner_text()

    @property
    def place(self) -> str:
        return str(self.page.evaluate("location.hash"))

    def inside_viewport(self, selector: str) -> bool:
        """Whether the whole of the first such element is on the screen."""
        box, size = self.page.locator(selector).first.bounding_box(), self.page.viewport_size
        if box is None or size is None:
            return False
        right, bottom = box["x"] + box["width"], box["y"] + box["height"]
        return box["x"] >= -1 and box["y"] >= -1 and right <= size["width"] + 1 and bottom <= size["height"] + 1

    def wait_for_state(self, words: str, seconds: float) -> None:
        """Wait until the job's badge has these words."""
        self.sees(words, seconds, ".job-head")

    def close(self) -> None:
        self.context.close()


def until(happens: Callable[[], bool], seconds: float, what: str) -> None:
    """Ask until it is so."""
    limit = patience(seconds)
    while not happens():
        assert not limit.over, what
        time.sleep(0.1)


def shot(panel: Panel, name: str) -> None:
    """A picture of the whole page for a person, where ``PANEL_SHOTS`` names a folder."""
    if folder := os.environ.get("PANEL_SHOTS"):
        panel.page.wait_for_timeout(3000)  # a picture in the page is drawn once its library is there
        panel.page.screenshot(path=f"{folder}/{name}.png", full_page=True)

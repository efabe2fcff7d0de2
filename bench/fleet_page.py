"""``python -m bench.fleet_page [--vehicles 20]``: campaigns of a fleet, begun by hand from the page in Chromium.

Selects all vehicles, starts a preflight and then a gyro campaign, and measures each: its time, the page's pictures a
second, the longest answer of ``GET /jobs`` meanwhile, and the memory of the service. Every vehicle is a process of its
own, so their processors count too. Exit code 1: an answer took longer than 0.3 s.
"""

from __future__ import annotations

import argparse
import shutil
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from playwright.sync_api import Page, sync_playwright

from bench.rows import Row, Section, machine, shown
from bench.running import RunningService, service
from mavcal.client import Client
from tests.ui.rooms import connected, endpoint

CHROMIUM = next((p for n in ("chromium", "chromium-browser", "google-chrome") if (p := shutil.which(n))), None)
FLAGS = ("--no-sandbox", "--disable-dev-shm-usage", "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1")
ANSWER_S = 0.3
COUNT = """() => {
  window.pictures = 0;
  const again = () => { window.pictures += 1; requestAnimationFrame(again); };
  requestAnimationFrame(again);
}"""


@dataclass(frozen=True)
class Measured:
    """One campaign from the press of its button to its end."""

    name: str
    seconds: float
    pictures: float
    """Requests of the page in a second."""
    answer_s: float
    """The longest answer of ``GET /jobs``."""
    memory_mb: float


class Asking(threading.Thread):
    """Asks for the jobs five times a second, and keeps the longest answer."""

    def __init__(self, url: str) -> None:
        super().__init__(daemon=True)
        self.longest, self._over, self._url = 0.0, threading.Event(), url

    def run(self) -> None:
        """Until it is stopped."""
        with Client(self._url) as client:
            while not self._over.wait(0.2):
                began = time.monotonic()
                client.list_jobs(order="newest", limit=60)
                self.longest = max(self.longest, time.monotonic() - began)

    def stop(self) -> float:
        """The longest answer, s."""
        self._over.set()
        self.join()
        return self.longest


def main(argv: Sequence[str] | None = None) -> int:
    """Measure both campaigns."""
    parser = argparse.ArgumentParser(prog="python -m bench.fleet_page", description=__doc__)
    parser.add_argument("--vehicles", type=int, default=20)
    asked = parser.parse_args(argv)
    if CHROMIUM is None:
        print("Chromium is not here: nothing is measured", file=sys.stderr)
        return 1
    with (
        tempfile.TemporaryDirectory() as folder,
        sync_playwright() as playwright,
        service(endpoint(1, speed=1, seed=1), Path(folder) / "data") as running,
    ):
        for number in range(2, asked.vehicles + 1):
            connected(running.client, endpoint(number, speed=1, seed=number))
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=[*FLAGS])
        page = browser.new_page(viewport={"width": 1280, "height": 860})
        page.set_default_timeout(600_000)
        found = [campaign(page, running, name) for name in ("Preflight", "Gyro")]
        browser.close()
    section = Section(f"Campaigns of {asked.vehicles} vehicles from the page", tuple(r for m in found for r in rows(m)))
    print(shown(section))
    print(f"\n{machine()}")
    return 0 if section.met else 1


def campaign(page: Page, running: RunningService, name: str) -> Measured:
    """Select all, press, and wait for the end."""
    page.goto(running.url)
    page.get_by_role("button", name="All (").click()
    page.evaluate(COUNT)
    asking, began = Asking(running.url), time.monotonic()
    asking.start()
    page.get_by_role("button", name=name, exact=True).click()
    if name != "Preflight":
        page.get_by_role("button", name="Start", exact=True).click()
    page.wait_for_selector(".title .badge.good")
    seconds = time.monotonic() - began
    return Measured(
        name, seconds, page.evaluate("window.pictures") / seconds, asking.stop(), running.resident_bytes() / 1e6
    )


def rows(found: Measured) -> list[Row]:
    """What was measured, as rows of a page."""
    return [
        Row(f"{found.name}: from the button to the end", "", f"{found.seconds:.0f} s"),
        Row(f"{found.name}: pictures a second of the page", "", f"{found.pictures:.0f}"),
        Row(
            f"{found.name}: longest answer of `GET /jobs`",
            f"<= {ANSWER_S:g} s",
            f"{found.answer_s:.2f} s",
            found.answer_s <= ANSWER_S,
        ),
        Row(f"{found.name}: memory of the service", "", f"{found.memory_mb:.0f} MB"),
    ]


if __name__ == "__main__":
    sys.exit(main())

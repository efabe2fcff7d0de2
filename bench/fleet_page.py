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


def asking(url: str, over: threading.Event, took: list[float]) -> None:
    """Ask for the jobs five times a second."""
    with Client(url) as client:
        while not over.wait(0.2):
            began = time.monotonic()
            client.list_jobs(order="newest", limit=60)
            took.append(time.monotonic() - began)


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
        rows = [row for name in ("Preflight", "Gyro") for row in campaign(page, running, name)]
        browser.close()
    section = Section(f"Campaigns of {asked.vehicles} vehicles from the page", tuple(rows))
    print(shown(section))
    print(f"\n{machine()}")
    return 0 if section.met else 1


def campaign(page: Page, running: RunningService, name: str) -> list[Row]:
    """Select all, press, and wait for the end; what was measured."""
    page.goto(running.url)
    page.get_by_role("button", name="All (").click()
    page.evaluate(COUNT)
    over, took, began = threading.Event(), [0.0], time.monotonic()
    thread = threading.Thread(target=asking, args=(running.url, over, took), daemon=True)
    thread.start()
    page.get_by_role("button", name=name, exact=True).click()
    if name != "Preflight":
        page.get_by_role("button", name="Start", exact=True).click()
    page.wait_for_selector(".title .badge.good")
    seconds = time.monotonic() - began
    over.set()
    thread.join()
    pictures, answer = page.evaluate("window.pictures") / seconds, max(took)
    return [
        Row(f"{name}: from the button to the end", "", f"{seconds:.0f} s"),
        Row(f"{name}: pictures a second of the page", "", f"{pictures:.0f}"),
        Row(f"{name}: longest answer of `GET /jobs`", f"<= {ANSWER_S:g} s", f"{answer:.2f} s", answer <= ANSWER_S),
        Row(f"{name}: memory of the service", "", f"{running.resident_bytes() / 1e6:.0f} MB"),
    ]


if __name__ == "__main__":
    sys.exit(main())

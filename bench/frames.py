"""``python -m bench.frames``: how smoothly the strip charts of the live room run, in a headless Chromium.

A simulated vehicle is asked for 200 samples a second of three inertial units, and the page is left until it has a
minute of them. Then pictures of the charts and of the page are counted, and the processor time of every process of the
browser. Chromium draws in software here: no GPU helps. Exit code 1: a chart has less than 30 pictures a second.
"""

from __future__ import annotations

import argparse
import os
import shutil
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from playwright.sync_api import Browser, Page, sync_playwright

from bench.page import machine, shown
from bench.rows import Row, Section
from bench.running import RunningService, service

CHROMIUM = next((p for n in ("chromium", "chromium-browser", "google-chrome") if (p := shutil.which(n))), None)
FLAGS = ("--no-sandbox", "--disable-dev-shm-usage", "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1")
SIZES = {"desk": (1280, 860), "phone": (360, 740)}
RATE_HZ = 200
FILLED_S = 66.0
"""Until the charts have their minute."""
TARGET = 30.0
SHORT = 0.5
"""So much less counts as reached: it is counted over a time that is no whole number of pictures."""
COUNT = """() => {
  const counted = { frames: 0, drawing_ms: 0, page_ms: 0 };
  window.counted = counted;
  const again = () => { counted.frames += 1; requestAnimationFrame(again); };
  requestAnimationFrame(again);
  const strip = customElements.get("strip-chart").prototype;
  const draw = strip._draw;
  strip._draw = function () {
    const began = performance.now();
    draw.call(this);
    counted.drawing_ms += performance.now() - began;
  };
}"""
READ = """() => ({ ...window.counted, at: performance.now(),
  pictures: [...document.querySelectorAll("strip-chart")].map((chart) => chart.pictures) })"""


@dataclass(frozen=True)
class Counted:
    """What was counted during one measurement."""

    seconds: float
    frames: float
    """Frames of the page per second."""
    pictures: tuple[float, ...]
    """Frames of each chart per second."""
    drawing_ms: float
    """JavaScript of one picture of all charts, ms."""
    shares: dict[str, float]
    """Processor time a second, by kind of process."""
    caption: str


def main(argv: Sequence[str] | None = None) -> int:
    """Measure both sizes of page."""
    parser = argparse.ArgumentParser(prog="python -m bench.frames", description=__doc__)
    parser.add_argument("--autopilot", choices=("ardupilot", "px4"), default="ardupilot")
    parser.add_argument("--seconds", type=float, default=60.0)
    asked = parser.parse_args(argv)
    if CHROMIUM is None:
        print("Chromium is not here: nothing is measured", file=sys.stderr)
        return 1
    rows: list[Row] = []
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        connect = f"sim:{asked.autopilot}?seed=3&hand=off"
        with service(connect, Path(folder) / "data") as running:
            for name, size in SIZES.items():
                browser = playwright.chromium.launch(executable_path=CHROMIUM, args=[*FLAGS])
                rows += _rows(name, _measured(browser, running, size, asked.seconds))
                browser.close()
    section = Section("Strip charts of the live room", tuple(rows))
    print(shown(section))
    print(f"\n{machine()}")
    return 0 if section.met else 1


def _measured(browser: Browser, running: RunningService, size: tuple[int, int], seconds: float) -> Counted:
    page = browser.new_page(viewport={"width": size[0], "height": size[1]})
    page.set_default_timeout(120_000)
    page.goto(f"{running.url}#/vehicle/{running.found()}/live")
    page.get_by_role("button", name=f"{RATE_HZ} Hz").click()
    page.wait_for_selector("strip-chart canvas")
    page.evaluate(COUNT)
    page.locator("strip-chart").first.scroll_into_view_if_needed()
    page.wait_for_timeout(1000 * FILLED_S)
    return _counted(browser, page, seconds)


def _counted(browser: Browser, page: Page, seconds: float) -> Counted:
    session = browser.new_browser_cdp_session()
    before, used, began = page.evaluate(READ), _used(session), time.monotonic()
    page.wait_for_timeout(1000 * seconds)
    after, used_after, ended = page.evaluate(READ), _used(session), time.monotonic()
    span = (after["at"] - before["at"]) / 1000
    pictures = [b - a for a, b in zip(before["pictures"], after["pictures"], strict=True)]
    return Counted(
        span,
        (after["frames"] - before["frames"]) / span,
        tuple(count / span for count in pictures),
        (after["drawing_ms"] - before["drawing_ms"]) / max(pictures),
        {kind: (used_after[kind] - used.get(kind, 0.0)) / (ended - began) for kind in used_after},
        page.locator("figcaption").first.inner_text(),
    )


def _used(session: Any) -> dict[str, float]:
    """Processor time so far by kind of process, s."""
    found: dict[str, float] = {}
    for process in session.send("SystemInfo.getProcessInfo")["processInfo"]:
        found[process["type"]] = found.get(process["type"], 0.0) + process["cpuTime"]
    return found


def _rows(name: str, counted: Counted) -> list[Row]:
    slowest = min(counted.pictures)
    shares = ", ".join(f"{kind} {share:.2f}" for kind, share in sorted(counted.shares.items()) if share >= 0.005)
    return [
        Row(
            f"{name}: pictures a second of the slowest of {len(counted.pictures)} charts, {counted.seconds:.0f} s",
            f">= {TARGET:g}",
            f"{slowest:.1f}",
            slowest >= TARGET - SHORT,
        ),
        Row(f"{name}: pictures a second of the page", "", f"{counted.frames:.1f}"),
        Row(f"{name}: JavaScript of one picture of all charts", "", f"{counted.drawing_ms:.1f} ms"),
        Row(f"{name}: processors used by the browser, of {os.cpu_count()}", "", shares),
        Row(f"{name}: what the first chart says", "", " ".join(counted.caption.split())),
    ]


if __name__ == "__main__":
    sys.exit(main())

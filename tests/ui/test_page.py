"""The page in a real browser against a running service: what a person does with it."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from mavcal.service.api.security import digest
from mavcal.service.simvehicle import SimulatedVehicle

from .browser import CHROMIUM, DRIVER, Browser, browser

pytestmark = [
    pytest.mark.ui,
    pytest.mark.skipif(not (CHROMIUM and DRIVER), reason="Chromium and its driver are not here"),
]
NEWEST = "#jobs > :first-child"
BARE = {"thermal": False, "parameters": {"INS_GYR_CAL": 0}}
"""A vehicle without a gyro calibration of its own: there is something to write, and to prove."""


@contextmanager
def service(folder: Path, *arguments: str, **environment: str) -> Iterator[str]:
    """A running service: its address."""
    command = [sys.executable, "-m", "mavcal", "serve", "--json", "--port", "0", "--data-dir", str(folder / "data")]
    with (
        (folder / "service.log").open("w") as log,
        subprocess.Popen(
            [*command, *arguments], stdout=subprocess.PIPE, stderr=log, env={**os.environ, **environment}
        ) as process,
    ):
        try:
            assert process.stdout is not None
            line = process.stdout.readline()
            assert line, (folder / "service.log").read_text()
            yield str(json.loads(line)["url"])
        finally:
            process.terminate()


@pytest.fixture(scope="module")
def opened() -> Iterator[Browser]:
    with browser() as it:
        yield it


@pytest.fixture
def window(opened: Browser) -> Browser:
    """The one browser, with nothing left of the test before."""
    opened.open("about:blank")
    opened.resize(1280, 900)
    opened.complaints()
    return opened


def test_a_gyro_is_calibrated_written_and_taken_back(window, tmp_path):
    with (
        SimulatedVehicle("ardupilot", seed=31, speed=10, config=BARE) as v,
        service(tmp_path, "--connect", v.url) as url,
    ):
        before = v.parameters()[1]
        window.open(url)
        window.until("#connection", "live")
        window.until("#vehicles", "disarmed")
        window.until("#vehicles", "Gyro offset at rest")
        window.click("Gyro offset at rest", "#vehicles")
        window.until(NEWEST, "review")
        assert window.run("return document.querySelector('#vehicles button').disabled") is False
        table = window.text(f"{NEWEST} table")
        assert all(f"INS_GYR{n}OFFS_{axis}" in table for n in (2, 3) for axis in "XYZ")
        assert "rad/s" in table
        assert v.parameters()[1]["INS_GYR2OFFS_X"] == before["INS_GYR2OFFS_X"]  # looking writes nothing

        window.click("Write to the vehicle", NEWEST)
        window.until(NEWEST, "succeeded")
        assert v.parameters()[1]["INS_GYR2OFFS_X"] != before["INS_GYR2OFFS_X"]
        window.until(NEWEST, "Written: ")
        assert "Proof: " in window.text(NEWEST)
        assert "The stream proves " in window.text(NEWEST)
        for width, height in ((1280, 900), (390, 844), (320, 640)):
            window.resize(width, height)
            assert window.run("return document.documentElement.scrollWidth") <= width
        window.click("Take back", NEWEST)
        window.until(NEWEST, "reverted")
        assert v.parameters()[1]["INS_GYR2OFFS_X"] == before["INS_GYR2OFFS_X"]
        assert window.complaints() == []


def test_poses_are_asked_for_and_a_job_is_cancelled(window, tmp_path):
    with SimulatedVehicle("ardupilot", seed=32, speed=10, config={"thermal": False}) as v:
        with service(tmp_path, "--connect", v.url) as url:
            window.open(url)
            window.until("#vehicles", "Accelerometer offsets")
            window.click("Accelerometer offsets, scales and cross terms from poses", "#vehicles")
            window.until(NEWEST, "Still missing: left")
            window.until(NEWEST, "1 of 10 poses")
            v.call("hold", pose="left")
            window.until(NEWEST, "2 of 10 poses")
            assert all(b is True for b in window.run(_DISABLED))
            window.click("Cancel", NEWEST)
            window.until(NEWEST, "cancelled")
            assert not any(window.run(_DISABLED))
        window.until("#connection", "trying again")  # the service has gone: it is said, and tried again


def test_a_number_that_is_asked_for_is_typed_and_kept_while_the_prompt_changes(window, tmp_path):
    with (
        SimulatedVehicle("ardupilot", seed=34, speed=10, config={"thermal": False}) as v,
        service(tmp_path, "--connect", v.url) as url,
    ):
        v.call("hold", pose="left", tremor_deg=2.0)
        window.open(url)
        window.until("#vehicles", "on a turntable")
        window.click("Gyro scale, cross axes and offset on a turntable", "#vehicles")
        window.until(NEWEST, "State the true rate")
        window.type(f"{NEWEST} input", "45")
        v.call("hold", pose="level", tilt_deg=0.0, tremor_deg=0.0)
        window.until(NEWEST, "At rest: leave it alone. State the true rate")  # the card was drawn again
        assert window.run(f"return document.querySelector('{NEWEST} input').value") == "45"
        window.click("Answer", NEWEST)
        window.until(NEWEST, "Turn it clockwise (seen from above) at 45 deg/s")
        window.click("Cancel", NEWEST)
        window.until(NEWEST, "cancelled")
        assert window.complaints() == []


_DISABLED = "return [...document.querySelectorAll('#vehicles button')].map(b => b.disabled)"


def test_a_button_stays_the_same_while_the_progress_moves(window, tmp_path):
    """A button that is exchanged between press and release swallows the click."""
    with (
        SimulatedVehicle("ardupilot", seed=33, speed=10, config={"thermal": False}) as v,
        service(tmp_path, "--connect", v.url) as url,
    ):
        window.open(url)
        window.until("#vehicles", "Drift of")
        v.call("warm_up", start=30.0, end=60.0, tau_s=120.0)
        window.click("Drift of accelerometers and gyros with temperature", "#vehicles")
        window.until(NEWEST, "finish")
        for _ in range(5):  # a warning, too, may draw the card again; progress never does
            window.run("document.querySelector('#jobs .actions button').marked = true")
            window.until_other(f"{NEWEST} .progress")
            if stayed := window.run("return document.querySelector('#jobs .actions button').marked") is True:
                break
        assert stayed
        window.click("Cancel", NEWEST)
        window.until(NEWEST, "cancelled")


def test_links_are_opened_refused_and_closed_and_text_stays_text(window, tmp_path):
    with service(tmp_path) as url:
        window.open(url)
        window.until("#connection", "live")
        window.until("#no-vehicles", "No vehicle")
        window.type("#link-url", "ftp:nowhere")
        window.click("Open link")
        window.until("#notice", "Known forms")
        window.complaints()  # a refused request is told there, too
        window.run("document.querySelector('#link-url').value = ''")
        window.type("#link-url", "serial:/dev/<img src=x onerror=document.title='hurt'>:57600")
        window.click("Open link")
        window.until("#notice", "<img src=x")
        window.complaints()
        assert window.run("return document.querySelectorAll('img').length") == 0
        assert window.run("return document.title") == "mavcal"
        window.run("document.querySelector('#link-url').value = ''")
        window.type("#link-url", "serial:/dev/ttyNONE9:57600")
        window.click("Open link")
        window.until("#links", "ttyNONE9")
        window.click("Close", "#links")
        window.until_other("#links")
        assert window.run("return document.querySelectorAll('#links li').length") == 0
        assert window.complaints() == []


def test_with_keys_the_page_asks_for_one(window, tmp_path):
    keys = [{"name": "crew", "sha256": digest("open sesame"), "scopes": ["admin"]}]
    with service(tmp_path, MAVCAL_API_KEYS=json.dumps(keys)) as url:
        window.open(url)
        window.until("#key-form", "API key")
        window.until("#connection", "no key")
        window.type("#key", "wrong")
        window.click("Use it", "#key-form")
        window.until("#key-form", "API key")
        window.until("#connection", "no key")
        window.type("#key", "open sesame")
        window.click("Use it", "#key-form")
        window.until("#connection", "live")
        assert window.run("return document.getElementById('key-form').checkVisibility()") is False
        window.type("#link-url", "tcp:127.0.0.1:1")
        window.click("Open link")
        window.until("#links", "down")  # told by the stream that the ticket opened


def test_the_documentation_is_drawn_from_local_files_under_the_policy(window, tmp_path):
    with service(tmp_path) as url:
        window.open(f"{url}docs")
        assert "/api/v1/vehicles/{vehicle_id}/jobs" in window.until("#interface", "/healthz").replace("\u200b", "")
        loaded = window.run("return performance.getEntriesByType('resource').map(e => e.name)")
        assert all(name.startswith((url, "data:")) for name in loaded), loaded
        assert window.complaints() == []

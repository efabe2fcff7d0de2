"""What goes wrong while somebody works: the panel says so where the eye is, covers no prompt and goes on by itself."""

from __future__ import annotations

import json
import re

import pytest

from mavcal.client import Client
from mavcal.service.api.security import digest
from mavcal.service.simvehicle import SimulatedVehicle
from tests.ui.rooms import connected, large

from .panel import KEPT, PHONE, Panel, service, sim, until
from .test_panel_jobs import prompt_and_button_in_sight

HUGE_MB = 40
SLOW_BYTES_PER_S, SLOW_LATENCY_MS = 30_000, 400

pytestmark = [pytest.mark.timeout(300), pytest.mark.long]


def test_two_browsers_on_one_review_write_it_once_and_both_see_it(browser, desk, tmp_path):
    with service(tmp_path, "--connect", sim(config=KEPT)) as url:
        desk.open(url)
        desk.calibrate("Gyro").click()
        desk.wait_for_state("Ready for your review", 60)
        other = Panel(browser, PHONE)
        other.open(url, desk.place)
        other.wait_for_state("Ready for your review", 30)
        desk.page.locator(".dock button.primary").click()
        other.wait_for_state("Done", 120)
        desk.wait_for_state("Done", 120)
        other.press("Take back")
        other.press("Yes, write the old values")
        desk.wait_for_state("Taken back", 90)
        assert other.complaints == desk.complaints == []
        other.close()


def test_a_vehicle_that_is_lost_in_mid_job_is_told_in_the_prompt(phone, tmp_path):
    with service(tmp_path) as url, Client(url) as client:
        with SimulatedVehicle("ardupilot", speed=3) as vehicle:
            known = connected(client, vehicle.url)
            job = client.start_job(known, kind="accel").id
            phone.open(url, f"#/job/{job}")
            phone.sees("1 of 10 poses", 90, ".prompt")
        phone.sees("is silent", 60, ".prompt .say")
        phone.sees("gives up in", 10, ".prompt .seen")
        prompt_and_button_in_sight(phone)
        assert phone.page.locator(".now .notice").count() == 0  # said once


def test_a_key_that_is_withdrawn_in_mid_session_is_asked_for_again_and_the_page_goes_on(desk, tmp_path):
    def keys(word: str) -> str:
        return json.dumps([{"name": "crew", "sha256": digest(word), "scopes": ["admin"]}])

    with service(tmp_path, MAVCAL_API_KEYS=keys("open sesame")) as url:
        desk.open(url, "#/setup")
        desk.page.fill("#key", "open sesame")
        desk.press("Use this key")
        desk.sees("Live", inside=".connection")
        desk.sees("No connection is open")
    port = int(url.rsplit(":", 1)[1].strip("/"))
    with service(tmp_path, port=port, MAVCAL_API_KEYS=keys("another word")):
        desk.sees("This service asks for an API key", 60)
        assert desk.place == "#/setup"
        desk.page.fill("#key", "another word")
        desk.press("Use this key")
        desk.sees("Live", inside=".connection")
        desk.sees("No connection is open")  # where it was


def test_a_huge_log_shows_how_far_it_is_can_be_stopped_and_is_read(desk, tmp_path):
    path = large(tmp_path / "huge.csv", HUGE_MB)
    with service(tmp_path) as url:
        desk.open(url, "#/logs")
        session = desk.context.new_cdp_session(desk.page)
        slow = {"offline": False, "latency": 0, "downloadThroughput": -1, "uploadThroughput": 4_000_000}
        session.send("Network.emulateNetworkConditions", slow)
        desk.page.set_input_files("input[type=file]", str(path))
        desk.sees("Uploading huge.csv:", inside=".drop")
        until(lambda: re.search(r"huge.csv: [1-9]", desk.text(".drop")) is not None, 60, "it says how far it is")
        desk.press("Cancel")
        desk.sees("Drop a log here", inside=".drop")
        session.send("Network.emulateNetworkConditions", {**slow, "uploadThroughput": -1})
        desk.page.set_input_files("input[type=file]", str(path))
        desk.sees("huge.csv", 120, "h1")
        desk.sees("Gyro 1", 60, ".charts")


def test_a_log_beyond_the_limit_is_refused_with_the_limit(desk, tmp_path):
    path = large(tmp_path / "huge.csv", 2)
    with service(tmp_path, MAVCAL_LIMITS__UPLOAD_BYTES="1000000") as url:
        desk.open(url, "#/logs")
        desk.page.set_input_files("input[type=file]", str(path))
        desk.sees("larger than 1000000 bytes", 60, ".notice")
        assert desk.page.locator(".drop").count() == 1


def test_over_a_slow_link_the_panel_opens_and_a_job_is_followed(desk, tmp_path):
    with service(tmp_path, "--connect", sim(speed=2, config=KEPT)) as url:
        session = desk.context.new_cdp_session(desk.page)
        session.send(
            "Network.emulateNetworkConditions",
            {
                "offline": False,
                "latency": SLOW_LATENCY_MS,
                "downloadThroughput": SLOW_BYTES_PER_S,
                "uploadThroughput": SLOW_BYTES_PER_S,
            },
        )
        desk.open(url)
        desk.sees("Live", 60, ".connection")
        desk.calibrate("Gyro").click(timeout=120_000)
        desk.wait_for_state("Ready for your review", 180)
        desk.sees("wrong by up to", 60, ".headline")

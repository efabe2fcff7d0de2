"""The mounting of a compass on the page: what was found, with its picture, and another one chosen by hand."""

from __future__ import annotations

import pytest
from playwright.sync_api import expect

from mavcal.client import Client
from tests.ui.rooms import connected, reviewed

from .panel import HAND, Panel, service, shot, sim, until

DESK = {"width": 1280, "height": 800}
TURNED = {
    "thermal": False,
    "imu_count": 1,
    "parameters": {"INS_GYR_CAL": 0},
    "mag_orientations": [0, 6, 0],
    "mag_orientation_parameters": [0, 0, 0],
}
"""The second compass is turned by yaw 270, and the vehicle is not told."""

pytestmark = [pytest.mark.timeout(300), pytest.mark.long]


@pytest.mark.parametrize("size", [HAND, DESK], ids=["phone", "desk"])
def test_a_mounting_is_found_shown_chosen_and_confirmed(browser, tmp_path, size):
    name = f"mounting-{size['width']}"
    with service(tmp_path) as url, Client(url) as client:
        vehicle = connected(client, sim(config=TURNED, speed=20))
        job = reviewed(client, vehicle, "mag")
        panel = Panel(browser, size)
        panel.open(url, f"#/job/{job}")
        panel.sees("Compass 2 takes", inside=".mounting")
        panel.sees("Confirm it below, once you have looked", inside=".review")
        shot(panel, f"{name}-found")
        choice = panel.page.get_by_label("Mounting of compass 2")
        expect(choice.locator("option").first).to_contain_text("stated now: none")

        choice.select_option("yaw 180")  # which its movement speaks against
        panel.sees("the chosen mounting (yaw 180) is 90 deg from the one that its movement shows", inside=".review")
        panel.sees("Compass 2 as chosen: yaw 180.", inside=".mounting-choice")
        expect(panel.page.locator(".mounting-choice attitude-scene canvas")).to_be_attached()
        shot(panel, f"{name}-refused")

        choice.select_option("yaw 270")
        panel.sees("compass 2 is mounted as chosen (yaw 270)", inside=".review")
        confirm = panel.page.get_by_label("I have looked: the compass is mounted as said")
        confirm.check()
        until(lambda: client.get_plan(job).blockers == [], 20, "it is confirmed")
        expect(panel.page.locator(".review [role=alert]")).to_have_count(0)
        assert {c.name: c.new for c in client.get_plan(job).changes}["COMPASS_ORIENT2"] == 6
        expect(confirm).to_be_checked()  # and can be taken back
        assert "--" not in panel.text(".review")
        assert panel.page.evaluate("document.documentElement.scrollWidth") <= size["width"]
        shot(panel, f"{name}-chosen")
        confirm.uncheck()
        until(lambda: client.get_plan(job).blockers != [], 20, "it is no longer confirmed")
        assert panel.complaints == []
        panel.close()

"""What a phone shows of a history, of parameters and of a review: nothing wider than it, rows of one line."""

from __future__ import annotations

import json
from collections.abc import Iterator

import pytest
from playwright.sync_api import Route, expect

from mavcal.client import Client
from tests.ui.rooms import connected, endpoint, reviewed, written

from .panel import Panel, service

PHONE = {"width": 390, "height": 844}
WIDTH = "document.documentElement.scrollWidth"

pytestmark = pytest.mark.timeout(300)


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[str, str, str]]:
    """A service with a vehicle whose gyros were calibrated, and whose accelerometer waits in its review."""
    with service(tmp_path_factory.mktemp("phone")) as url, Client(url) as client:
        vehicle = connected(client, endpoint(1, speed=8))
        written(client, vehicle, "gyro")
        yield url, vehicle, reviewed(client, vehicle, "accel")


@pytest.mark.long
def test_a_history_fits_a_phone_and_is_titled_by_the_vehicle(browser, place):
    url, vehicle, _ = place
    phone = Panel(browser, PHONE)
    phone.open(url, f"#/history/{vehicle}")
    phone.sees("Gyro 1", inside="main")
    assert phone.page.evaluate(WIDTH) <= PHONE["width"]
    expect(phone.page.locator("h1")).to_have_text("History of ArduPilot 1")
    row = phone.page.locator(".rows .row").first
    box = row.bounding_box()
    assert box is not None
    assert box["height"] <= 60
    row.locator("summary").click()
    expect(row).to_contain_text("offset, deg/s")
    assert phone.page.evaluate(WIDTH) <= PHONE["width"]
    assert phone.complaints == []
    phone.close()


@pytest.mark.long
def test_parameters_are_rows_of_one_line_whose_reason_is_folded(browser, place):
    url, _, job = place
    phone = Panel(browser, PHONE)
    phone.open(url, f"#/job/{job}")
    phone.page.get_by_text("parameters: old, new, uncertainty").click()
    rows = phone.page.locator(".rows .row")
    expect(rows.first).to_be_visible()
    heights = [row.bounding_box() for row in rows.all()]
    assert len(heights) >= 18
    assert all(box is not None and box["height"] <= 48 for box in heights), heights
    rows.first.locator("summary").click()
    expect(rows.first).to_contain_text("why")
    assert phone.page.evaluate(WIDTH) <= PHONE["width"]
    phone.close()


@pytest.mark.long
def test_the_picture_of_a_review_is_not_blown_up_and_what_is_not_written_is_not_ticked(browser, place):
    url, _, job = place
    agreeing = [
        {
            "sensor": "accel",
            "instance": i,
            "deviation": 1.0,
            "text": f"accelerometer {i + 1} agrees with what is in force",
        }
        for i in (1, 2)
    ]

    def agreed(route: Route) -> None:
        answer = route.fetch()
        told = answer.json()
        told["plan"]["agreements"] = agreeing
        told["plan"]["warnings"] = [agreeing[0]["text"], *told["plan"]["warnings"]]
        route.fulfill(response=answer, body=json.dumps(told))

    desk = Panel(browser, {"width": 1280, "height": 860})
    desk.page.route(f"**/api/v1/jobs/{job}", agreed)
    desk.open(url, f"#/job/{job}")
    picture = desk.page.locator(".before-after img")
    expect(picture).to_be_visible()
    assert picture.evaluate("i => i.complete && i.clientWidth <= i.naturalWidth")
    expect(desk.page.get_by_label("Accelerometer 1")).to_be_checked()
    expect(desk.page.get_by_label("Accelerometer 2")).not_to_be_checked()
    desk.sees("nothing new to write", inside=".choices")
    assert desk.page.get_by_text(agreeing[0]["text"].capitalize()).count() == 1  # a note is read once
    desk.close()


@pytest.mark.long
def test_a_compass_that_is_mounted_otherwise_is_told_in_words_and_a_picture_without_a_flag(browser, place):
    url, _, job = place
    upside_down = {"verdict": "rotated", "name": "roll_180", "matrix": [[1, 0, 0], [0, -1, 0], [0, 0, -1]]}
    blocker = "compass 1 is mounted turned: look at it. Confirm it with the plan option confirm_mounting (--c)"

    def mounted(route: Route) -> None:
        answer = route.fetch()
        told = answer.json()
        told["results"][0] |= {"sensor": "mag", "instance": 0}
        told["results"][0]["quality"]["orientation"] = upside_down
        told["plan"]["blockers"] = [blocker]
        route.fulfill(response=answer, body=json.dumps(told))

    desk = Panel(browser, {"width": 1280, "height": 860})
    desk.page.route(f"**/api/v1/jobs/{job}", mounted)
    desk.open(url, f"#/job/{job}")
    desk.sees("Compass 1 takes the top for the underside.", inside=".mounting")
    expect(desk.page.locator(".mounting attitude-scene canvas")).to_be_attached()
    expect(desk.page.get_by_label("I have looked: the compass is mounted as said")).to_be_visible()
    desk.sees("Confirm it below, once you have looked.", inside=".review")
    assert "--" not in desk.text(".review .notice")
    desk.close()

"""Before and beside a job: what is asked for and said once, a look that waits, a method that needs a number, a log."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from playwright.sync_api import expect

from mavcal.client import Client
from tests.ui.rooms import connected, flown

from .panel import HAND, KEPT, service, shot, sim, until

ANNOUNCED = """() => {
  const said = document.querySelector(".prompt .say").textContent;
  const live = "[aria-live=assertive], [aria-live=polite], [role=status], [role=alert]";
  return [...document.querySelectorAll(live)].filter((region) => region.textContent.includes(said)).length;
}"""
"""How many regions that are read aloud hold the prompt."""

pytestmark = pytest.mark.timeout(300)


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[str, Client]]:
    with service(tmp_path_factory.mktemp("desk")) as url, Client(url) as client:
        yield url, client


@pytest.mark.long
def test_propellers_are_named_before_and_a_look_waits_for_the_job_that_runs(hand, place):
    url, client = place
    vehicle = connected(client, sim(speed=3, system_id=1, hand="off"))
    hand.open(url, f"#/vehicle/{vehicle}")
    for tile in ("Accelerometer", "Compass"):
        expect(hand.page.get_by_role("region", name=tile)).to_contain_text("propellers off")
    hand.calibrate("Accelerometer").click()
    hand.sees("1 of 10 poses", 90, ".prompt")
    assert hand.page.evaluate(ANNOUNCED) == 1
    cancel = hand.page.get_by_role("button", name="Cancel").bounding_box()
    assert cancel is not None
    assert cancel["width"] < HAND["width"] / 2  # the way out is not what a thumb falls on
    job = hand.place.rsplit("/", 1)[1]
    hand.open(url, f"#/vehicle/{vehicle}/preflight")
    hand.sees("It takes 10 to 30 s", inside="main")
    hand.sees("Accelerometer goes on: look when it has ended", inside="main")
    expect(hand.page.get_by_role("button", name="Look now")).to_be_disabled()
    client.cancel_job(job)
    expect(hand.page.get_by_role("button", name="Look now")).to_be_enabled()


@pytest.mark.long
def test_a_compass_at_one_known_heading_is_started_with_that_heading(hand, place):
    url, client = place
    vehicle = connected(client, sim(speed=8, system_id=2, seed=4, config=KEPT))
    hand.open(url, f"#/vehicle/{vehicle}")
    hand.page.get_by_text("More: level horizon and other methods").click()
    method = hand.page.locator(".methods li").filter(has=hand.page.locator("form"))
    expect(method).to_have_count(1)
    method.get_by_role("button", name="Start").click()
    assert hand.place == f"#/vehicle/{vehicle}"  # the heading has to be given
    shot(hand, "fixed-yaw")
    method.get_by_role("spinbutton").fill("0")
    method.get_by_role("button", name="Start").click()
    until(lambda: any(job.kind == "mag-fixed-yaw" for job in client.list_jobs(vehicle_id=vehicle)), 30, "it begins")
    hand.wait_for_state("Ready for your review", 90)
    hand.sees("Heading is wrong by up to", inside=".headline")
    assert hand.page.locator(".mounting-choice").count() == 0  # its mounting was taken for granted
    assert client.list_jobs(vehicle_id=vehicle, kind="mag-fixed-yaw")[0].options["heading"] == 0.0


@pytest.mark.long
def test_a_log_is_told_on_three_screens_of_a_phone(hand, place):
    url, client = place
    log = client.upload_recording(flown(), name="flight.csv").id
    hand.open(url, f"#/log/{log}")
    hand.sees("What is worth fitting", 60)
    hand.page.wait_for_timeout(2000)
    shot(hand, "log-flight")
    assert hand.page.evaluate("document.documentElement.scrollHeight") <= 3 * HAND["height"]
    hand.page.get_by_text("Its sensors over time").click()  # the rest is folded, not gone
    expect(hand.page.locator(".charts figure").first).to_be_visible()

"""Several vehicles at once: selected on the home page, sent through a campaign, watched in one table."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from playwright.sync_api import expect

from mavcal.client import Client
from tests.ui.rooms import connected, endpoint

from .panel import Panel, service, until

PHONE = {"width": 390, "height": 844}
WIDTH = "document.documentElement.scrollWidth"

pytestmark = pytest.mark.timeout(600)


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[str, Client, list[str]]]:
    """A service with three vehicles; the second carries a tag."""
    with service(tmp_path_factory.mktemp("fleet")) as url, Client(url) as client:
        vehicles = [connected(client, endpoint(n, speed=8, seed=n)) for n in (1, 2, 3)]
        client.change_unit(vehicles[1], tags=["north"])
        yield url, client, vehicles


def over(panel: Panel) -> None:
    """Wait until the campaign has gone through its vehicles."""
    until(lambda: panel.page.locator(".title .badge.good").count() == 1, 240, "the campaign is done")


@pytest.mark.long
def test_until_the_first_answer_the_page_looks_and_offers_no_simulated_vehicle(browser, fleet):
    url, _, _ = fleet
    desk = Panel(browser)
    desk.page.route("**/api/v1/**", lambda _: None)  # no answer; vehicles come by the stream of events too
    desk.open(url)
    desk.sees("Looking for vehicles", inside="main")
    assert desk.page.get_by_role("button").filter(has_text="Try a simulated").count() == 0
    desk.page.unroute("**/api/v1/**")
    desk.open(url)
    desk.sees("ArduPilot 1", inside="main")
    desk.close()


@pytest.mark.long
def test_vehicles_are_selected_and_preflighted_as_one_campaign(browser, fleet):
    url, _, _ = fleet
    panel = Panel(browser, PHONE)
    panel.open(url)
    expect(panel.page.get_by_role("button", name="Preflight", exact=True)).to_be_disabled()
    panel.press("All (3)")
    panel.sees("3 of 3 selected", inside=".hands")
    panel.page.get_by_label("Select ArduPilot 3").uncheck()
    panel.sees("2 of 3 selected", inside=".hands")
    panel.press("Preflight")
    panel.sees("Preflight of 2 vehicles", inside="h1")
    assert panel.page.evaluate(WIDTH) <= PHONE["width"]
    over(panel)
    rows = panel.page.locator(".campaign tbody tr")
    expect(rows).to_have_count(2)
    expect(panel.page.locator(".campaign .state").get_by_text("runs")).to_have_count(0)
    assert panel.page.evaluate(WIDTH) <= PHONE["width"]
    assert panel.complaints == []
    panel.close()


@pytest.mark.long
def test_a_campaign_of_calibrations_asks_first_and_shows_whom_it_needs(browser, fleet):
    url, client, vehicles = fleet
    panel = Panel(browser)
    panel.open(url)
    panel.press("Tag north (1)")
    panel.sees("1 of 3 selected", inside=".hands")
    panel.press("All (3)")
    panel.press("Gyro")
    panel.sees("Each needs the vehicle lying still", inside=".hands")
    panel.sees("each plan waits for your review", inside=".hands")
    panel.press("Start")
    panel.sees("Gyro of 3 vehicles", inside="h1")
    over(panel)
    rows = panel.page.locator(".campaign tbody tr")
    expect(rows.first).to_contain_text("ready for your review")
    assert {job.vehicle_id for job in client.list_jobs(kind="gyro")} == set(vehicles)
    rows.first.get_by_role("link", name="Open").click()
    panel.sees("Ready for your review", inside=".job-head")
    panel.close()


@pytest.mark.long
def test_what_was_never_verified_is_not_restored_and_the_table_says_so(browser, fleet):
    url, client, _ = fleet
    panel = Panel(browser)
    panel.open(url)
    panel.press("All (3)")
    panel.press("Restore")
    panel.press("Start")
    panel.sees("Restore of 3 vehicles", inside="h1")
    over(panel)
    job = client.list_jobs(kind="campaign", order="newest", limit=1)[0]
    assert job.options["task"] == "restore"
    assert {item.outcome for item in client.list_items(job.id)} == {"failed"}  # nothing was verified here yet
    panel.sees("failed", inside=".campaign")
    panel.close()


@pytest.mark.long
def test_the_title_names_page_and_state_and_focus_never_falls_to_the_body(browser, fleet):
    url, _, vehicles = fleet
    desk = Panel(browser)
    inside = "() => document.activeElement !== document.body && document.activeElement !== null"
    desk.open(url)
    desk.sees("ArduPilot 1", inside="main")
    until(lambda: desk.page.title() == "Vehicles (3) · mavcal", 20, "the title of the home page")
    desk.page.get_by_role("link", name="ArduPilot 1", exact=True).focus()
    desk.page.keyboard.press("Enter")
    until(lambda: desk.page.title() == "ArduPilot 1: disarmed · mavcal", 20, "the title of the vehicle")
    until(lambda: bool(desk.page.evaluate(inside)), 10, "focus in the room")
    desk.open(url, f"#/vehicle/{vehicles[2]}/preflight")
    desk.page.get_by_role("button", name="Look now").focus()
    desk.page.keyboard.press("Enter")
    desk.sees("Looking", inside="main")
    assert desk.page.evaluate(inside)
    desk.sees("Barrier at for", 60, inside="main")
    assert desk.page.evaluate(inside)
    desk.close()

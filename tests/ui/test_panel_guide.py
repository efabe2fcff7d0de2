"""The job page in the hand: one screen of a hand, poses, silence, what was left out, and the way out."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import expect

from mavcal.client import Client
from mavcal.service.simvehicle import Operator, SimulatedVehicle
from tests.ui.rooms import connected

from .panel import KEPT, Panel, service, shot, sim, until

FITS = """() => {
  const box = (selector) => document.querySelector(selector)?.getBoundingClientRect();
  const boxes = [".prompt", ".stage", ".faces, .compass-list", ".dock button"].map(box);
  if (boxes.some((one) => !one)) return null;
  const [dock, stage] = [box(".dock"), boxes[1]];
  const inside = (b) => b.left >= -1 && b.top >= -1 && b.right <= innerWidth + 1 && b.bottom <= innerHeight + 1;
  return boxes.every(inside) && boxes.slice(0, 3).every((b) => b.bottom <= dock.top + 1) && stage.height >= 149;
}"""
"""Whether prompt, picture, tiles and button are whole on the screen, and the button hides none; null: not shown now."""

FRAMES = """() => {
  Object.assign(window, { frames: 0, lost: [] });
  const whole = (found) => {
    const b = found.getBoundingClientRect();
    return b.left >= -1 && b.top >= -1 && b.right <= innerWidth + 1 && b.bottom <= innerHeight + 1;
  };
  const look = () => {
    const shown = [...document.querySelectorAll(".running .prompt, .dock button")];
    if (document.querySelector(".running")) window.frames += 1;
    if (!shown.every(whole)) window.lost.push(document.querySelector(".job-room").innerText);
    requestAnimationFrame(look);
  };
  look();
}"""
"""Looks at every frame that is drawn from now on, while a job runs: prompt and buttons are whole on the screen."""


def seen_in_every_frame(panel: Panel) -> None:
    frames, lost = panel.page.evaluate("[window.frames, window.lost.slice(0, 3)]")
    assert frames > 10
    assert lost == []


pytestmark = [pytest.mark.timeout(600), pytest.mark.long]


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[str, Client]]:
    folder: Path = tmp_path_factory.mktemp("guide")
    with service(folder) as url, Client(url) as client:
        yield url, client


def test_an_accelerometer_in_the_hand(hand, running):
    url, client = running
    vehicle = connected(client, sim(speed=3, system_id=1, config=KEPT))
    job = client.start_job(vehicle, kind="accel").id
    hand.open(url, f"#/job/{job}")
    page = hand.page
    page.wait_for_selector(".faces li")
    page.evaluate(FRAMES)
    expect(page.locator(".faces li")).to_have_count(10)  # six faces and four tilts, each with a tile of its own
    names = page.locator(".faces .name").all_inner_texts()
    assert names[-1] == "Tilted 4"
    stale: list[str] = []
    shown: set[str] = set()

    def captured() -> bool:
        fits = page.evaluate(FITS)
        if fits is None:
            return "Waiting for you" not in hand.text(".job-head") and "Measuring" not in hand.text(".job-head")
        if not fits:
            shot(hand, "accel-does-not-fit")
        assert fits, hand.text(".prompt")
        said, seen = page.evaluate(
            "['.say', '.seen'].map((s) => document.querySelector('.prompt ' + s)?.textContent ?? '')"
        )
        if "hold it" in seen and not said.split(". ")[-1].startswith("Hold it"):
            stale.append(f"{said} / {seen}")
        if "low" in said or "half down" in said:
            shown.add(said)
            shot(hand, "accel-tilted")
        shot(hand, f"accel-{page.locator('.faces .done').count()}")
        return False

    until(captured, 240, "the capture ends")
    assert stale == []
    assert any("a third down" in said and "side low" in said for said in shown), shown
    hand.wait_for_state("Ready for your review", 90)
    client.choose_hand(vehicle, hand="mouse")  # it stays as it is until somebody has looked
    client.turn_vehicle(vehicle, attitude=[1.0, 0.0, 0.0, 0.0])  # level alone proves less than the last tilt does
    page.locator(".dock button.primary").click()
    proofs: set[str] = set()

    def proved() -> bool:
        said = page.evaluate("document.querySelector('.prompt .say')?.textContent ?? ''")
        if said.startswith("Hold it still") and page.evaluate("!!document.querySelector('.dock .why')"):
            proofs.add(said)
            shot(hand, f"accel-proof-{len(proofs)}")
            assert page.locator(".stage attitude-scene").count() == 1, "a pose has its picture"
            assert "unproved" in hand.text(".dock .why")
            assert page.locator("details[open] table").count() == 0, "the table is folded"
            assert ", then" not in said
            client.choose_hand(vehicle, hand="auto")
        return "Done" in hand.text(".job-head .badge")

    until(proved, 240, "the write ends")
    assert proofs, "poses prove the rest, one at a time"
    assert not any(said.count("nose") + said.count("side") > 1 for said in proofs), proofs
    seen_in_every_frame(hand)
    shot(hand, "accel-done")
    hand.press("Take back")
    expect(page.locator(".dock button.primary")).to_have_count(1)
    expect(page.locator(".dock button")).to_have_count(2)
    shot(hand, "accel-undo")
    hand.press("Yes, write the old values")
    hand.wait_for_state("Taken back", 120)
    hand.sees("The old values are back and read", inside=".outcome.good")
    assert "not proved" not in hand.text("main")
    shot(hand, "accel-undone")
    assert hand.complaints == []


SEEN = """() => [...document.querySelectorAll(".faces canvas")].map((canvas) => {
  const pixels = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;
  return pixels.filter((value, i) => i % 4 === 3 && value > 200).length / (canvas.width * canvas.height);
})"""
"""Which share of each pose's picture is drawn on."""


APART = """() => {
  const [, left, right] = [...document.querySelectorAll(".faces canvas")].map((canvas) =>
    canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data);
  return left.filter((value, i) => Math.abs(value - right[i]) > 64).length / left.length;
}"""
"""Share of the pixels by which the pictures of the left and of the right side differ."""


def test_no_pose_is_seen_from_its_edge_alone_and_the_picture_is_whole_at_a_desk(browser, running):
    url, client = running
    vehicle = connected(client, sim(speed=3, system_id=5, hand="off"))
    job = client.start_job(vehicle, kind="accel").id
    desk = Panel(browser, {"width": 1280, "height": 800})
    desk.open(url, f"#/job/{job}")
    desk.sees("1 of 10 poses", 90, ".prompt")
    until(lambda: desk.page.locator(".faces canvas").count() == 10, 30, "ten pictures")
    until(lambda: min(desk.page.evaluate(SEEN)) > 0.15, 10, f"{desk.page.evaluate(SEEN)}")
    assert desk.page.evaluate(APART) > 0.05, "left and right are told apart"
    expect(desk.page.locator(".stage .turn-arrow")).to_be_attached()
    stage, dock = desk.page.locator(".stage").bounding_box(), desk.page.locator(".dock").bounding_box()
    assert stage is not None
    assert dock is not None
    assert stage["y"] + stage["height"] <= dock["y"]
    shot(desk, "desk-poses")
    client.cancel_job(job)
    desk.close()


def test_a_compass_in_the_hand(hand, running):
    url, client = running
    vehicle = connected(client, sim(speed=2, system_id=2, seed=4, config=KEPT))
    job = client.start_job(vehicle, kind="mag").id
    hand.open(url, f"#/job/{job}")
    page = hand.page
    page.evaluate(FRAMES)
    page.wait_for_selector(".compass-card")
    primary: list[str] = []

    def captured() -> bool:
        fits = page.evaluate(FITS)
        if fits is None:
            return page.locator(".guide.compass").count() == 0
        assert fits, hand.text(".prompt")
        middle = page.locator(".stage .middle attitude-scene").count()
        assert middle == 1 or page.evaluate(FITS) is None, "the vehicle turns with the sphere"
        shot(hand, "compass")
        if page.locator(".dock .why").count():
            shot(hand, "compass-finish")
            primary.extend(page.locator(".dock button.primary").all_inner_texts())
        return False

    until(captured, 240, "the capture ends")
    assert "Finish" not in primary, "not while the asked uncertainty is not reached"
    hand.wait_for_state("Ready for your review", 90)
    page.locator(".dock button.primary").first.click()
    hand.wait_for_state("Done", 240)
    seen_in_every_frame(hand)


def test_a_silent_vehicle_leaves_the_poses_as_they_are_and_counts_down(hand, running):
    url, client = running
    with SimulatedVehicle("ardupilot", speed=3, system_id=3) as vehicle:
        known = connected(client, vehicle.url)
        job = client.start_job(known, kind="accel").id
        hand.open(url, f"#/job/{job}")
        hand.sees("1 of 10 poses", 90, ".prompt")
    hand.sees("is silent", 60, ".prompt")
    hand.sees("Vehicle silent", 10, ".connection.warn")
    assert hand.page.locator(".faces .done").count() == 1
    assert hand.page.locator(".now .notice").count() == 0, "it is said once"
    first = hand.text(".prompt .seen")
    until(lambda: hand.text(".prompt .seen") != first, 10, "it counts")
    assert "gives up in" in first
    assert "left" not in hand.text(".prompt .advance")
    shot(hand, "silent")
    hand.press("Cancel")
    hand.sees("Stop the accelerometer calibration? Nothing has been written.", inside=".dock")
    shot(hand, "cancel")
    hand.press("Go on")
    assert hand.page.locator(".prompt").count() == 1
    hand.press("Cancel")
    hand.press("Stop it")
    hand.wait_for_state("Cancelled", 30)
    hand.sees("Nothing was written", inside=".outcome")
    shot(hand, "cancelled")


def test_a_dead_gyro_is_the_headline_of_everything(hand, running):
    url, client = running
    with SimulatedVehicle("ardupilot", speed=6, system_id=4, config=KEPT) as dead:
        vehicle, operator = connected(client, dead.url), Operator(dead)
        dead.call("fault", kind="stuck", sensor="gyro", instance=0)
        for kind in ("gyro", "accel"):
            operator.rest()
            job = client.start_job(vehicle, kind=kind).id

            def obeyed(job: str = job) -> bool:
                now = client.get_job(job)
                operator.follow(None if now.prompt is None else now.prompt.model_dump(mode="json"))
                return now.state in {"review", "succeeded", "failed"}

            until(obeyed, 240, f"the {kind} is measured")
            hand.open(url, f"#/job/{job}")
            hand.wait_for_state("Ready for your review", 30)
            hand.sees("Gyro 1 is left out", inside=".outcome.bad")
            hand.sees("It is frozen", inside=".outcome.bad")
            assert hand.inside_viewport(".left-out")
            shot(hand, f"dead-{kind}-review")
            if kind == "gyro":
                hand.sees("4 of 4 pass for what is written", inside=".review")
                hand.page.locator(".dock button.primary").click()
                hand.wait_for_state("Done in part", 120)
                hand.sees("Gyro 1 is left out", inside=".outcome.bad")
                shot(hand, "dead-gyro-done")
        hand.open(url, f"#/vehicle/{vehicle}")
        expect(hand.page.locator(".tile.bad").first).to_contain_text("Gyro 1 was left out: it is frozen")
        shot(hand, "dead-tile")


def test_a_service_that_has_gone_says_what_is_known(hand, tmp_path):
    with service(tmp_path, "--connect", sim(speed=3, hand="off")) as url:
        hand.open(url)
        hand.calibrate("Accelerometer").click()
        hand.sees("1 of 10 poses", 90, ".prompt")
    hand.sees("Service not reached since", 30, ".now .notice")
    assert "go on" not in hand.text("body")
    shot(hand, "service-gone")

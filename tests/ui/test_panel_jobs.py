"""Whole calibrations as a person makes them, with a simulated vehicle that does what the prompts ask for."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from playwright.sync_api import expect

from mavcal.service.simvehicle import free_udp_port
from tests.service.gap_tables import write_table

from .panel import DESK, KEPT, PHONE, Panel, service, sim, until

WATCH_STATES = """() => {
  window.seenStates = [];
  new MutationObserver(() => document.querySelectorAll("td .badge").forEach((badge) => {
    const words = badge.textContent.replace(/^\\W+/, "").trim();
    if (!window.seenStates.includes(words)) window.seenStates.push(words);
  })).observe(document.body, { subtree: true, childList: true, characterData: true });
}"""
"""Every word that stood beside a parameter."""

pytestmark = pytest.mark.timeout(600)


FIRST = """([shown, counted]) => {
  window.first = null;
  new MutationObserver(() => {
    const found = document.querySelector(shown);
    if (window.first !== null || !found) return;
    window.first = counted ? document.querySelectorAll(counted).length : Number(found.ariaLabel.match(/\\d+/)[0]);
  }).observe(document.body, { subtree: true, childList: true });
}"""
"""How many of something the first drawing has in which something is shown, or the number that this is labelled with: a
question from outside comes later."""
IN_SIGHT = """() => document.querySelector(".faces") && [".prompt", ".dock button"].every((selector) => {
  const box = document.querySelector(selector)?.getBoundingClientRect();
  return box && box.left >= -1 && box.top >= -1 && box.right <= innerWidth + 1 && box.bottom <= innerHeight + 1;
})"""
"""Asked at one instant, since a capture may end between two; null when it has ended."""


def prompt_and_button_in_sight(panel: Panel) -> bool:
    """Whether the capture goes on; prompt and button are on the screen then."""
    in_sight = panel.page.evaluate(IN_SIGHT)
    assert in_sight is not False, panel.text("body")
    return in_sight is not None


def first_shown(panel: Panel) -> object:
    """What :data:`FIRST` was to find."""
    until(lambda: panel.page.evaluate("window.first") is not None, 30, "the first drawing")
    return panel.page.evaluate("window.first")


def test_a_gyro_by_keyboard_alone(desk, tmp_path):
    with service(tmp_path, "--connect", sim(speed=4, config=KEPT)) as url:
        desk.open(url)
        desk.calibrate("Gyro").focus()
        desk.page.keyboard.press("Enter")
        desk.wait_for_state("Ready for your review", 60)
        desk.sees("Rate at rest is wrong by up to", inside=".headline")
        desk.page.evaluate(WATCH_STATES)
        desk.page.locator(".dock button.primary").focus()
        desk.page.keyboard.press("Enter")
        desk.wait_for_state("Done", 120)
        seen = desk.page.evaluate("window.seenStates")
        assert {"waits", "written"} <= set(seen), "each parameter is followed while it is written"
        desk.sees("was wrong by up to", inside=".headline")
        desk.page.get_by_role("button", name="Take back").focus()
        desk.page.keyboard.press("Enter")
        desk.page.get_by_role("button", name="Yes, write the old values").focus()
        desk.page.keyboard.press("Enter")
        desk.wait_for_state("Taken back", 90)
        assert desk.complaints == []


@pytest.mark.long
def test_an_accelerometer_on_a_phone_with_the_prompt_always_in_sight(phone, tmp_path):
    with service(tmp_path, "--connect", sim(speed=6, config=KEPT)) as url:
        phone.open(url)
        phone.page.evaluate(FIRST, [".faces li", ".faces .done"])
        phone.calibrate("Accelerometer").click()
        assert first_shown(phone) == 0, "nothing was measured yet"
        seen: set[int] = set()

        def captured() -> bool:
            if not prompt_and_button_in_sight(phone):
                return True
            phone.page.mouse.wheel(0, 200)  # whoever scrolls still sees both
            phone.page.wait_for_timeout(100)
            prompt_and_button_in_sight(phone)
            phone.page.mouse.wheel(0, -200)
            seen.add(phone.page.locator(".faces .done").count())
            return False

        until(captured, 180, "the capture ends")
        assert len(seen) >= 3  # the faces turned green one after the other
        phone.wait_for_state("Ready for your review", 60)
        phone.sees("Acceleration is wrong by up to", inside=".headline")
        expect(phone.page.locator(".before-after img")).to_be_visible()
        assert phone.page.evaluate("document.documentElement.scrollWidth") <= PHONE["width"]
        until(lambda: phone.inside_viewport(".dock button.primary"), 10, "the button in sight")
        phone.page.locator(".dock button.primary").click()
        phone.wait_for_state("Done", 180)
        phone.sees("Proved", inside=".outcome")
        phone.press("Take back")
        phone.press("Yes, write the old values")
        phone.wait_for_state("Taken back", 120)
        assert phone.complaints == []


@pytest.mark.long
def test_a_compass_beside_a_magnet_ends_early_with_cause_and_remedy(desk, tmp_path):
    magnet = {"truth": {"mags": [{"offset": [420.0, 60.0, -30.0]}, {"offset": [400.0, 0.0, 0.0]}]}}
    with service(tmp_path, "--connect", sim(config=magnet)) as url:
        desk.open(url)
        desk.calibrate("Compass").click()
        desk.wait_for_state("Failed", 180)
        desk.sees("magnet", inside=".outcome")
        desk.sees("What helps:", inside=".outcome")
        expect(desk.page.get_by_role("button", name="Try again")).to_be_visible()


@pytest.mark.long
def test_a_compass_shows_what_is_covered_and_where_to_turn_next(desk, tmp_path):
    covered = "Number(document.querySelector('field-sphere').ariaLabel.match(/\\d+/)[0])"
    with service(tmp_path, "--connect", sim(speed=2, config=KEPT)) as url:
        desk.open(url)
        desk.page.evaluate(FIRST, ["field-sphere", ""])
        desk.calibrate("Compass").click()
        assert first_shown(desk) == 0
        desk.sees("turn a full circle", 90, ".prompt")
        until(
            lambda: desk.page.evaluate("document.querySelector('field-sphere')?._field.next") is not None,
            60,
            "an arrow",
        )
        until(lambda: desk.page.evaluate(covered) > 20, 90, "the covered directions grow")
        desk.press("Cancel")
        desk.press("Stop it")
        desk.wait_for_state("Cancelled", 30)


@pytest.mark.long
def test_a_reload_and_a_second_browser_find_the_job_where_it_was(browser, desk, tmp_path):
    with service(tmp_path, "--connect", sim(speed=3, hand="off", config=KEPT)) as url:
        desk.open(url)
        desk.page.evaluate(FIRST, [".faces li", ".faces .done"])
        desk.calibrate("Accelerometer").click()
        assert first_shown(desk) == 0  # nothing is done before the first prompt
        desk.sees("1 of 10 poses", 90, ".prompt")
        desk.sees("Level is done. Turn it to the next one.", inside=".prompt")
        assert desk.page.locator(".faces .done").all_inner_texts() == ["Level\n✓"]
        assert desk.page.locator(".hold-ring.held").count() == 0
        place = desk.place
        desk.page.reload()
        desk.sees("1 of 10 poses", 30, ".prompt")
        assert desk.place == place
        other = Panel(browser, PHONE)
        other.open(url, place)
        other.sees("1 of 10 poses", 30, ".prompt")
        assert prompt_and_button_in_sight(other)
        other.press("Cancel")
        other.press("Stop it")
        desk.wait_for_state("Cancelled", 30)
        other.close()


@pytest.mark.long
def test_the_service_restarts_in_mid_job_and_the_page_goes_on(desk, tmp_path):
    endpoint = sim(speed=3, hand="off")
    with service(tmp_path, "--connect", endpoint) as url:
        desk.open(url)
        desk.calibrate("Accelerometer").click()
        desk.sees("1 of 10 poses", 90, ".prompt")
    until(lambda: "Live" not in desk.text(".connection"), 30, "the page says that the service has gone")
    expect(desk.page.locator(".prompt")).to_be_visible()  # nothing covers what the person was told
    with service(tmp_path, "--connect", endpoint, port=int(url.rsplit(":", 1)[1].strip("/"))):
        desk.sees("Live", 60, ".connection")
        # The simulated vehicle ended with the service; the job says what has become of it.
        known = ("Failed", "Interrupted", "Waiting", "Measuring")
        until(lambda: any(word in desk.text(".job-head .badge") for word in known), 60, "the job is shown")


@pytest.mark.long
def test_a_gap_is_diagnosed_and_its_report_shown(desk, tmp_path):
    real = write_table(tmp_path / "real.csv")
    with service(tmp_path) as url:
        desk.open(url, "#/gap")
        desk.page.locator("input[type=file]").first.set_input_files(str(real))
        desk.sees("real.csv", inside=".drop.done")
        desk.press("Diagnose")
        desk.sees("differ", 240, ".first-line")
        expect(desk.page.locator("iframe.report")).to_be_visible()


@pytest.mark.long
def test_five_vehicles_fit_one_screen(browser, tmp_path):
    panel = Panel(browser, DESK)
    connects = [word for i in range(1, 6) for word in ("--connect", sim(seed=i, system_id=i, speed=1))]
    with service(tmp_path, *connects) as url:
        panel.open(url)
        cards, tiles = panel.page.locator(".vehicle-card"), panel.page.locator(".tile")
        until(lambda: cards.count() == 5, 120, "every vehicle is heard")
        until(lambda: tiles.count() == 20, 60, "every tile is there")
        expect(panel.page.locator(".tile button").first).to_be_visible()
        assert panel.page.evaluate("document.documentElement.scrollHeight") <= DESK["height"] + 4
    panel.close()


@contextmanager
def many(port: int, count: int) -> Iterator[None]:
    """So many vehicles on one UDP port, for which one process sends."""
    command = [sys.executable, "-m", "tests.ui.many_vehicles", str(port), str(count)]
    process = subprocess.Popen(command, cwd=Path(__file__).resolve().parents[2])
    try:
        yield
    finally:
        process.terminate()
        process.wait()


@pytest.mark.long
@pytest.mark.parametrize("size", [DESK, PHONE], ids=["desk", "phone"])
def test_twenty_vehicles_are_a_table(browser, tmp_path, size):
    panel, port = Panel(browser, size), free_udp_port()
    connects = ["--connect", f"udpin:127.0.0.1:{port}"]
    connects += [word for i in (19, 20) for word in ("--connect", sim(seed=i, system_id=i, speed=1))]
    with service(tmp_path, *connects) as url:
        panel.open(url)
        rows = panel.page.locator(".fleet tbody tr")
        with many(port, 18):
            until(lambda: rows.count() == 20, 120, "every vehicle is heard")
            until(lambda: panel.page.locator(".fleet .sensor .badge").count() == 80, 60, "each has four sensors")
            names = [name.split()[-1] for name in panel.page.locator(".fleet tbody th").all_inner_texts()]
            assert names == [str(i) for i in range(1, 21)]
            expect(rows.first.get_by_text("disarmed")).to_be_visible()
            assert "Begin with the gyro" in rows.first.locator(".needs").inner_text()
            assert panel.page.evaluate("document.documentElement.scrollWidth") <= size["width"]
        until(lambda: panel.page.locator(".fleet .badge.bad").count() == 18, 60, "eighteen have gone silent")
        panel.sees("No message for 3 s", inside=".fleet tbody tr")
        rows.last.get_by_role("link").first.click()
        panel.sees("system 20")
    panel.close()

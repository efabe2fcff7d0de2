"""Tones, speech, vibration and the screen that stays on: asked of the browser at the right moment, and never unasked.

Chromium has all four, headless too. What the page asks for is written down and passed on.
"""

from __future__ import annotations

import json

import pytest

from .panel import KEPT, Panel, service, sim, until

HEARD = """
window.heard = [];
const note = (kind, what) => setTimeout(() => heard.push({kind, what,
    prompt: document.querySelector('.prompt .say')?.textContent ?? '',
    held: document.querySelector('.prompt.stable') !== null,
    done: document.querySelectorAll('.faces .done').length})); // once the page shows what the sign is about
const passed = (owner, name, kind, what) => {
    const real = owner[name];
    owner[name] = function (...given) { note(kind, what.call(this, ...given)); return real.apply(this, given); };
};
passed(OscillatorNode.prototype, 'start', 'tone', function () { return this.frequency.value; });
passed(SpeechSynthesis.prototype, 'speak', 'speech', said => said.text);
passed(Navigator.prototype, 'vibrate', 'vibration', pattern => pattern);
passed(WakeLock.prototype, 'request', 'awake', () => 'asked');
passed(WakeLockSentinel.prototype, 'release', 'awake', () => 'released');
"""
NEXT, HOLD, DONE, FAIL = 660, 440, 1320, 330
"""Frequencies, Hz, each of which only this sign has (660 also begins a DONE)."""
ALL = {"sound": True, "speech": True, "vibration": True}

pytestmark = pytest.mark.timeout(300)


def opened(panel: Panel, url: str, chosen: dict[str, bool] | None) -> None:
    panel.page.add_init_script(HEARD)
    panel.open(url)
    if chosen is not None:
        panel.page.evaluate("chosen => localStorage.setItem('mavcal-cues', JSON.stringify(chosen))", chosen)
    panel.page.reload()


def heard(panel: Panel, kind: str, what: object = None) -> list[dict[str, object]]:
    signs = json.loads(panel.page.evaluate("JSON.stringify(heard)"))
    return [s for s in signs if s["kind"] == kind and what in (None, s["what"])]


@pytest.mark.long
def test_each_sign_comes_when_what_it_means_happens(desk, tmp_path):
    with service(tmp_path, "--connect", sim(speed=6, config=KEPT)) as url:
        opened(desk, url, ALL)
        desk.calibrate("Accelerometer").click()
        desk.wait_for_state("Ready for your review", 180)
        holds = heard(desk, "tone", HOLD)
        assert len(holds) >= 6  # each face begins to be held
        assert all(sign["held"] for sign in holds)
        finished = [sign for sign in heard(desk, "tone", DONE) if sign["prompt"]]
        turned = [sign["done"] for sign in finished if not str(sign["prompt"]).startswith("Computes")]
        assert turned == sorted(turned), turned  # tiles turn green, and none back
        before = heard(desk, "vibration")[0]["done"]  # the vehicle lies level already: that face may be done first
        assert before in (0, 1)
        # One a pose; where the first vibration comes late, the first face has sounded and is counted in `before` too.
        assert 9 - before <= len(finished) <= 10, turned
        spoken = heard(desk, "speech")
        assert spoken
        for sign in spoken[:-1]:
            assert str(sign["what"]).lower() == str(sign["prompt"]).lower()
        assert spoken[-1]["what"] == "Ready for your review."
        assert len(heard(desk, "vibration")) >= len(holds) + len(finished)
        until(
            lambda: [sign["what"] for sign in heard(desk, "awake")] == ["asked", "released"], 10, "the screen may sleep"
        )


def test_a_failure_sounds_and_is_spoken(desk, tmp_path):
    with service(tmp_path, "--connect", sim(speed=20, hand="off")) as url:
        opened(desk, url, ALL)
        desk.calibrate("Accelerometer").click()
        desk.wait_for_state("Failed", 120)
        assert len(heard(desk, "tone", FAIL)) == 1
        assert heard(desk, "speech")[-1]["what"] == "It did not work. Look at the screen."


def test_nothing_sounds_or_moves_unasked_and_a_button_of_the_job_asks(desk, tmp_path):
    with service(tmp_path, "--connect", sim(speed=2, config=KEPT)) as url:
        opened(desk, url, None)
        desk.calibrate("Gyro").click()
        desk.press("Tones off")
        desk.press("Tones on")
        desk.wait_for_state("Ready for your review", 120)
        assert [heard(desk, kind) for kind in ("tone", "speech", "vibration")] == [[], [], []]
        desk.press("Tones off")
        assert desk.page.evaluate("JSON.parse(localStorage.getItem('mavcal-cues'))") == {
            **dict.fromkeys(ALL, False),
            "sound": True,
        }
        desk.press("Discard")
        desk.wait_for_state("Cancelled", 30)
        desk.press("Try again")
        desk.wait_for_state("Ready for your review", 120)
        assert heard(desk, "tone", DONE)
        assert heard(desk, "speech") == heard(desk, "vibration") == []


def test_who_cancels_is_not_congratulated(desk, tmp_path):
    with service(tmp_path, "--connect", sim(speed=3, hand="off")) as url:
        opened(desk, url, ALL)
        desk.calibrate("Accelerometer").click()
        desk.sees("1 of 10 poses", 90, ".prompt")
        before = len(heard(desk, "tone", DONE))
        desk.press("Cancel")
        desk.wait_for_state("Cancelled", 30)
        desk.page.wait_for_timeout(500)
        assert len(heard(desk, "tone", DONE)) == before

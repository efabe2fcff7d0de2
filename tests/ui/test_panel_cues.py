"""Tones, speech, vibration and the screen that stays on: asked of the browser at the right moment, and never unasked.

Chromium has all four, headless too. What the page asks for is written down and passed on.
"""

from __future__ import annotations

import itertools
import json

import pytest

from .panel import KEPT, Panel, service, sim, until

HEARD = """
window.heard = [];
const note = (kind, what) => queueMicrotask(() => heard.push({kind, what,
    prompt: document.querySelector('.prompt .say')?.textContent ?? '',
    held: document.querySelector('.prompt.stable') !== null,
    done: document.querySelectorAll('.faces .done').length})); // once this drawing shows what the sign is about
const passed = (owner, name, kind, what) => {
    const real = owner[name];
    owner[name] = function (...given) { note(kind, what.call(this, ...given)); return real.apply(this, given); };
};
passed(OscillatorNode.prototype, 'start', 'tone', function () { return this.frequency.value; });
passed(SpeechSynthesis.prototype, 'speak', 'speech', said => said.text);
passed(Navigator.prototype, 'vibrate', 'vibration', pattern => pattern);
window.AudioContext = class extends AudioContext { constructor() { super(); window.audio = this; } };
passed(WakeLock.prototype, 'request', 'awake', () => 'asked');
passed(WakeLockSentinel.prototype, 'release', 'awake', () => 'released');
"""
DRAWN = """async () => {
    const { store } = await import('./panel/core/store.js');
    const draw = store._draw;
    window.drawn = [];
    store._draw = () => {
        draw();
        const job = store.full.get(store.place.id);
        if (job) drawn.push({missing: job.prompt?.remaining.length ?? null,
            held: document.querySelector('.prompt.stable') !== null});
    };
}"""
"""Writes down what each drawing of the page showed of a prompt: a page that is late leaves some prompts out."""
NEXT, HOLD, DONE, FAIL = 660, 440, 1320, 330
"""Frequencies, Hz, that only this sign has (660 also begins a DONE)."""
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
        desk.page.evaluate(DRAWN)
        desk.page.mouse.click(2, 2)  # sound is possible from the first touch on
        until(lambda: bool(desk.page.evaluate("window.audio?.state === 'running'")), 20, "sound")
        desk.calibrate("Accelerometer").click()
        desk.wait_for_state("Ready for your review", 180)
        shown = list(itertools.pairwise(desk.page.evaluate("window.drawn")))
        ended, begun = 0, 0
        for was, now in shown:
            known = None not in (was["missing"], now["missing"])
            ended += (fewer := known and now["missing"] < was["missing"])
            begun += not fewer and now["held"] and not was["held"]
        holds = heard(desk, "tone", HOLD)
        assert 0 < len(holds) == begun  # each pose that is seen to be held
        assert all(sign["held"] for sign in holds)
        finished = [sign for sign in heard(desk, "tone", DONE) if sign["prompt"]]
        assert 0 < len(finished) == ended <= 10  # each end of poses that is seen; of one pose, if nothing is late
        turned = [sign["done"] for sign in finished if not str(sign["prompt"]).startswith("Computes")]
        assert turned == sorted(turned), turned  # tiles turn green, and none back
        spoken = heard(desk, "speech")
        assert spoken
        for sign in spoken[:-1]:
            assert str(sign["what"]).lower() == str(sign["prompt"]).lower()
        assert spoken[-1]["what"] == "Ready for your review."
        assert len(heard(desk, "vibration")) >= len(holds) + len(finished)
        until(
            lambda: [sign["what"] for sign in heard(desk, "awake")] == ["asked", "released"], 10, "the screen may sleep"
        )


@pytest.mark.long
def test_a_failure_sounds_and_is_spoken(desk, tmp_path):
    with service(tmp_path, "--connect", sim(speed=20, hand="off")) as url:
        opened(desk, url, ALL)
        desk.calibrate("Accelerometer").click()
        desk.wait_for_state("Failed", 120)
        assert len(heard(desk, "tone", FAIL)) == 1
        assert heard(desk, "speech")[-1]["what"] == "It did not work. Look at the screen."


@pytest.mark.long
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
        desk.press("Discard it")
        desk.wait_for_state("Cancelled", 30)
        desk.press("Try again")
        desk.wait_for_state("Ready for your review", 120)
        assert heard(desk, "tone", DONE)
        assert heard(desk, "speech") == heard(desk, "vibration") == []


@pytest.mark.long
def test_who_cancels_is_not_congratulated(desk, tmp_path):
    with service(tmp_path, "--connect", sim(speed=3, hand="off")) as url:
        opened(desk, url, ALL)
        desk.calibrate("Accelerometer").click()
        desk.sees("1 of 10 poses", 90, ".prompt")
        before = len(heard(desk, "tone", DONE))
        desk.press("Cancel")
        desk.press("Stop it")
        desk.wait_for_state("Cancelled", 30)
        desk.page.wait_for_timeout(500)
        assert len(heard(desk, "tone", DONE)) == before

"""A level that comes and goes is no wander of a nominal recording, and a wander is no level."""

from __future__ import annotations

import numpy as np
import pytest

from mavcal.calib.gap.companion.level_shifts import level_steps
from mavcal.calib.gap.diagnose import diagnose
from mavcal.calib.gap.effects import catalogue
from mavcal.calib.gap.problem import GapProblem, MinimumGain, ReferenceInfo, ReferenceKind, Trace
from mavcal.calib.gap.reference.noise import learned_spectrum, with_noise
from mavcal.calib.recording import Sensor

FS, SECONDS, SD = 20.0, 160.0, 0.5
ON_S, OFF_S = 43.0, 99.0
LEVEL, LOUD = 100.0, 1000.0
"""Either step alone gains 70; the walk that stands for both 110, and is excused."""
MAGNET = np.array([-1.0, 2.0, 6.0])
EFFECTS = tuple(e for e in catalogue() if e.id in {"mag_step", "mag_random_walk", "mag_hard_iron", "mag_noise"})


def compass(seed, magnet=0.0, wander=1.3):
    """A compass in a room whose field differs from place to place: it wanders within some seconds."""
    rng = np.random.default_rng(seed)
    t = np.arange(int(FS * SECONDS)) / FS
    keep = np.exp(-1.0 / (3.0 * FS))
    steps = wander * np.sqrt(1.0 - keep**2) * rng.normal(size=(len(t), 3))
    room = np.zeros((len(t), 3))
    for k in range(1, len(t)):
        room[k] = keep * room[k - 1] + steps[k]
    there = ((t > ON_S) & (t < OFF_S))[:, None] * MAGNET * magnet
    measured = room + there + SD * rng.normal(size=room.shape)
    return Trace(Sensor.MAG, (0,), t, measured, 0.0 * measured, np.ones(len(t), dtype=bool))


def beside_a_nominal_one(trace, nominal):
    least = MinimumGain(level={Sensor.MAG: LEVEL}, noise_report={Sensor.MAG: LOUD})
    noisy = with_noise(trace, learned_spectrum(nominal), None)
    return GapProblem((noisy,), ReferenceInfo(ReferenceKind.POSE), SECONDS, nominal=(nominal,), minimum_gain=least)


def test_the_largest_step_is_where_the_level_changes():
    steps = level_steps(compass(1, magnet=1.0))
    assert steps.largest_near(ON_S) > 5.0
    assert steps.largest_near(OFF_S) > 5.0
    assert steps.largest == pytest.approx(np.linalg.norm(MAGNET), rel=0.3)
    assert level_steps(compass(1)).largest < 0.75 * steps.largest


@pytest.mark.long
def test_a_magnet_that_is_put_on_and_taken_off_is_two_steps():
    report = diagnose(beside_a_nominal_one(compass(1, magnet=1.0), compass(2)), effects=EFFECTS, nested=False)
    assert [e.id for e in report.effects] == ["mag_step"] * 2
    moments = sorted(p.value for e in report.effects for p in e.params if p.name == "time_s")
    assert moments == pytest.approx([ON_S, OFF_S], abs=1.0)


def test_a_room_that_differs_from_place_to_place_has_no_step():
    report = diagnose(beside_a_nominal_one(compass(3), compass(2)), effects=EFFECTS, nested=False)
    assert not report.effects

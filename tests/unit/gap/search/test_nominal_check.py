"""What a nominal recording shows as well is no gap: rows that repeat, lines of the mains."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mavcal.calib.gap.diagnose import diagnose
from mavcal.calib.gap.effects import by_id, forward_models
from mavcal.calib.gap.effects.base import LatticeEffect
from mavcal.calib.gap.model.hypotheses import Hypothesis
from mavcal.calib.gap.model.joint import Term
from mavcal.calib.gap.search.added_noise import nominal_has_tone
from mavcal.calib.gap.search.lattice_effects import nominal_has_samples
from mavcal.calib.recording import Sensor
from tests.unit.gap.synthetic import SIGMA, problem_of

HZ = 8.3
SIZE = 0.5 * SIGMA[Sensor.MAG]


def hum(factor):
    def gap(trace):
        wave = np.cos(2.0 * np.pi * HZ * trace.t)
        return factor * SIZE * np.outer(wave, [1.0, 0.5, 0.0])

    return gap


def trace_with(factor, seed=1):
    return problem_of(np.random.default_rng(seed), (Sensor.MAG,), hum(factor)).traces[0]


def tone(hz, size):
    effect = forward_models()["mag_tone"][0]
    return Term(Hypothesis(effect, (0,)), size * np.array([1.0, 0.5, 0.0, 0.0, 0.0, 0.0]), hz)


@pytest.mark.parametrize(("factor", "hz", "usual"), [(1.0, HZ, True), (0.05, HZ, False), (1.0, HZ + 1.0, False)])
def test_a_line_at_the_same_frequency_and_of_the_same_size_is_usual(factor, hz, usual):
    assert nominal_has_tone(tone(hz, SIZE), [trace_with(factor)]) is usual


def test_only_a_tone_of_the_same_sensor_is_asked_for():
    assert not nominal_has_tone(tone(HZ, SIZE), problem_of(np.random.default_rng(2), (Sensor.GYRO,), hum(1.0)).traces)
    step = Term(Hypothesis(forward_models()["mag_step"][0], (0,)), np.ones(3), HZ)
    assert not nominal_has_tone(step, [trace_with(1.0)])


@pytest.mark.long
def test_a_hum_of_the_nominal_recording_is_not_reported():
    real = problem_of(np.random.default_rng(3), (Sensor.MAG,), hum(1.0))
    assert "mag_tone" in {e.id for e in diagnose(real, nested=False).effects}
    beside = dataclasses.replace(real, nominal=(trace_with(1.0, seed=4),))
    assert not diagnose(beside, nested=False).effects


def repeating(seed, share):
    trace = problem_of(np.random.default_rng(seed), (Sensor.MAG,)).traces[0]
    measured = trace.measured.copy()
    rows = np.flatnonzero(np.random.default_rng(seed).random(len(measured)) < share)
    for row in rows[rows > 0]:
        measured[row] = measured[row - 1]
    return dataclasses.replace(trace, measured=measured)


def test_rows_that_repeat_in_both_are_usual():
    effect = by_id()["mag_hold"]
    assert isinstance(effect, LatticeEffect)
    evidence = effect.detect(repeating(5, 0.3))
    assert evidence is not None
    assert nominal_has_samples(effect, evidence, [repeating(6, 0.3)])
    assert not nominal_has_samples(effect, evidence, [repeating(6, 0.05)])
    assert not nominal_has_samples(effect, evidence, [])

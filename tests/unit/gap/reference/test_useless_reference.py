"""A reference whose attitude nothing determines: it is said first, and no sensor is judged by it."""

from __future__ import annotations

import functools
import math
from dataclasses import replace

import numpy as np
import pytest

from mavcal.calib import gap
from mavcal.calib.gap.export import Target, exported
from mavcal.calib.gap.problem import ReferenceInfo, ReferenceKind
from mavcal.calib.gap.reference import build
from mavcal.calib.gap.schema import USELESS_DEG, GapReport, GapVerdict, as_json
from mavcal.calib.gap_report import gap_to_html, verdict_sentence
from mavcal.calib.recording import Channel, Recording, Sensor, Stage

from .test_re_estimated import flight
from .test_recorded import channel

RATE, SECONDS = 50.0, 30.0
BIAS = np.array([0.2, -0.1, 0.15])


def resting(instances: int, gps_noise: float = 3.0) -> Recording:
    """A vehicle that rests for half a minute, without a compass and with a poor GPS. Its first unit has an offset."""
    rng = np.random.default_rng(1)
    t = np.arange(int(RATE * SECONDS)) / RATE
    channels = []
    for i in range(instances):
        accel = np.array([0.0, 0.0, -9.80665]) + BIAS * (i == 0) + 0.02 * rng.standard_normal((len(t), 3))
        channels.append(channel(Sensor.ACCEL, t, accel, i, "IMU"))
        channels.append(channel(Sensor.GYRO, t, 1e-3 * rng.standard_normal((len(t), 3)), i, "IMU"))
    gps = t[::20]
    velocity = gps_noise * rng.standard_normal((len(gps), 3))
    channels.append(Channel(Sensor.VELOCITY, 0, gps, velocity, "m/s", Stage.RAW, "GPS"))
    channels.append(channel(Sensor.ATTITUDE, t[::10], np.tile([1.0, 0.0, 0.0, 0.0], (len(t[::10]), 1)), 0, "ATT"))
    return Recording(tuple(channels))


@functools.cache
def diagnosed(instances: int) -> GapReport:
    return gap.run(resting(instances), nested=False)


def test_one_unit_is_not_judged_and_the_reference_is_said_first() -> None:
    report = diagnosed(1)
    assert report.inputs.att_sigma_deg > USELESS_DEG
    assert report.verdict is GapVerdict.REFERENCE
    assert report.effects == ()
    assert report.shrink is None
    assert not report.unknown.flag
    assert not report.tested
    assert {n.id for n in report.not_testable} == {"accel", "gyro"}
    assert all("headings" in n.need and "3 deg are needed" in n.reason for n in report.not_testable)
    said = verdict_sentence(report)
    assert said.startswith("The reference is of no use: its attitude is known to")
    assert "turns through all headings" in said
    document = as_json(report)
    assert document["inputs"]["reference"]["useless"] is True
    assert document["tested"] is False
    assert "The reference is of no use" in gap_to_html(report)


@pytest.mark.long
def test_a_trajectory_that_contradicts_its_own_inertial_unit_throughout_is_useless_too() -> None:
    known = diagnosed(1)
    report = replace(known, inputs=replace(known.inputs, att_sigma_deg=math.inf))
    assert report.inputs.useless
    assert as_json(report)["inputs"]["reference"]["att_sigma_deg"] is None
    assert "contradicts the inertial unit all the time" in verdict_sentence(report)
    assert "degrees" not in verdict_sentence(report)


@pytest.mark.long
def test_a_poorer_position_is_of_no_use_either() -> None:
    report = gap.run(resting(1, gps_noise=10.0), nested=False)
    assert report.verdict is GapVerdict.REFERENCE
    assert report.effects == ()
    assert report.inputs.att_sigma_deg > USELESS_DEG


@pytest.mark.long
def test_two_units_tell_of_each_other_what_needs_no_attitude() -> None:
    report = diagnosed(2)
    assert report.verdict is GapVerdict.REFERENCE
    assert report.tested
    assert [e.id for e in report.effects] == ["accel_bias"]
    found = {p.name: p.value for p in report.effects[0].params}
    sign = 1.0 if report.effects[0].instances == (1,) else -1.0  # of two, nothing says which
    assert sign * np.array([found[f"bias.{a}"] for a in "xyz"]) == pytest.approx(BIAS, abs=0.005)
    said = verdict_sentence(report)
    assert said.startswith("The reference is of no use")
    assert "a constant offset, accelerometer" in said
    assert "SIM_ACC" in exported(report, resting(2), Target.SITL).text


@pytest.mark.long
def test_nothing_to_export_is_told_with_its_reason() -> None:
    with pytest.raises(Exception, match="no sensor could be compared with the reference"):
        exported(diagnosed(1), resting(1), Target.SITL)


@pytest.mark.long
def test_a_companion_with_a_useless_reference_teaches_nothing_of_single_sensors() -> None:
    problem = build(flight(), None, [resting(1)])
    assert any("nothing was learned of single sensors" in w for w in problem.warnings)
    assert problem.nominal == ()
    assert not problem.reference.useless
    assert {t.sensor for t in problem.traces} == {Sensor.ACCEL, Sensor.GYRO, Sensor.MAG}


@pytest.mark.parametrize(
    ("kind", "degrees", "useless"),
    [
        (ReferenceKind.ESTIMATOR, 0.8, False),
        (ReferenceKind.ESTIMATOR, 1109.5, True),
        (ReferenceKind.ESTIMATOR, float("inf"), True),
        (ReferenceKind.ESTIMATOR, float("nan"), True),
        (ReferenceKind.POSE, 4.0, False),  # white noise of a camera, which goes down with the square root
        (ReferenceKind.REDUNDANT, 0.0, False),
    ],
)
def test_a_re_estimated_attitude_is_useless_from_a_few_degrees_on(
    kind: ReferenceKind, degrees: float, *, useless: bool
) -> None:
    assert ReferenceInfo(kind, degrees).useless is useless

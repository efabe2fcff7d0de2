"""Flights of a simulated vehicle with real firmware: what was injected, in the references before any diagnosis."""

from __future__ import annotations

import numpy as np
import pytest

from mavcal.calib import logs
from mavcal.calib.gap.problem import ReferenceKind
from mavcal.calib.gap.reference import build
from mavcal.calib.gap.reference.channels import corrected
from mavcal.calib.gap.reference.re_estimated import best_trajectory
from mavcal.calib.recording import Sensor

pytestmark = pytest.mark.shared


@pytest.fixture(scope="module")
def flights(shared_data):
    return lambda name: logs.read(shared_data / "sitl_flights" / f"{name}.bin")


@pytest.mark.long
def test_biases_read_as_injected_against_the_other_instance_and_along_the_trajectory(flights):
    problem = build(flights("bias"), flights("null"))
    assert problem.reference.kind == ReferenceKind.ESTIMATOR
    injected = {Sensor.ACCEL: [0.3, -0.2, 0.15], Sensor.GYRO: [0.01, -0.015, 0.008], Sensor.MAG: [-6.0, 4.0, -3.0]}
    within = {Sensor.ACCEL: 0.015, Sensor.GYRO: 2e-4, Sensor.MAG: 0.2}  # a tilt of 0.09 degrees, an eighth of its error
    for trace in problem.traces:
        mean = trace.residual[trace.observed].mean(axis=0)
        expected = np.array(injected[trace.sensor]) if trace.instances == (0,) else np.zeros(3)
        near = within[trace.sensor] if trace.against is None else 0.01 * within[trace.sensor] + 5e-5
        assert mean == pytest.approx(expected, abs=near), (trace.sensor, trace.instances, trace.against)


@pytest.mark.long
def test_currents_of_the_motors_are_inside_the_trajectory(flights):
    state = best_trajectory(corrected(flights("vib_motor_temp"))).state
    assert state.constants[3:6] == pytest.approx([0.3, -0.2, 0.4], abs=0.012)


@pytest.mark.long
def test_an_attitude_is_estimated_better_than_the_firmware_does(flights):
    null = flights("null")
    found = best_trajectory(corrected(null))
    truth = next(c for c in null.reference if c.sensor == Sensor.ATTITUDE)
    from mavcal.calib.gap.reference.ideal import continuous
    from mavcal.calib.gap.reference.posed import rotation
    from mavcal.calib.gap.reference.signals import interpolated

    at = rotation(interpolated(truth.t, continuous(truth.values), found.state.t))
    error = np.degrees((at.inv() * found.state.attitude).as_rotvec())
    assert np.sqrt((error[:, :2] ** 2).mean()) < 0.1
    assert np.sqrt((error[:, 2] ** 2).mean()) < 0.4

"""Jobs that were recorded against real firmwares, beside the truth."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mavcal.calib.firmware.ardupilot import parameters as ardupilot
from mavcal.calib.firmware.compose.plan import ComposeOptions, compose
from mavcal.calib.firmware.in_force.fingerprint import fingerprint
from mavcal.calib.firmware.in_force.undo import undo
from mavcal.calib.logs.tlog import read_tlog
from mavcal.calib.procedures.context import ProcedureContext
from mavcal.calib.procedures.protocol import Done
from mavcal.calib.procedures.replay import replay
from mavcal.calib.recording import Identity, Sensor

TRUTH = 1e-6 * np.array([[357, -263, 149], [2.1, -3.3, 1.7], [0.0, 0.0, 0.0]]).T
"""Drift of the first gyro about 35 degC, rad/s per degC, degC^2, degC^3; the second one does not drift."""


@pytest.fixture(scope="module")
def one_unit_drifts(shared_data: Path):
    """The recording, its parameters, and what the thermal job makes of it."""
    path = shared_data / "firmware_runs" / "ardupilot_thermal_one_unit_drifts.tlog"
    if not path.exists():
        pytest.skip(f"needs {path.name} beside the repository")
    recording = read_tlog(path.read_bytes())
    parameters = recording.parameters.final()
    units = {Sensor.ACCEL: (0, 1), Sensor.GYRO: (0, 1)}
    context = ProcedureContext(recording.identity, units, None, parameters)
    outcome = replay("thermal", {}, context, undo(recording), [])
    assert isinstance(outcome, Done), outcome
    return recording, parameters, outcome.results


@pytest.mark.shared
def test_the_unit_that_drifts_is_written_although_the_other_one_cannot_be(one_unit_drifts):
    recording, parameters, results = one_unit_drifts
    plan = compose(results, parameters, fingerprint(recording.identity, parameters))
    assert not plan.blockers
    after = {**parameters, **{c.name: c.new for c in plan.changes}}
    assert after["INS_TCAL1_ENABLE"] == 1
    assert "INS_TCAL2_ENABLE" not in {c.name for c in plan.changes}
    drift = ardupilot.calibration_in_force(after, Sensor.GYRO, 0).polynomial
    assert drift is not None
    sd = {c.name: c.sd for c in plan.changes}
    for axis, letter in enumerate("XYZ"):
        for order in range(3):
            error = abs(drift.coefficients[axis, order] - TRUTH[axis, order])
            assert error < 4.5e-6 * sd[f"INS_TCAL1_GYR{order + 1}_{letter}"]
    (second,) = [text for text in plan.warnings if text.startswith("gyro 2 ")]
    assert second == ("gyro 2 is left out: its drift with temperature is below what the stream resolves, on every axis")
    assert {(loss.sensor, loss.instance) for loss in plan.losses} == {(Sensor.ACCEL, 0), (Sensor.ACCEL, 1)}
    assert all("CALTEMP does not say" in loss.text for loss in plan.losses)


@pytest.mark.shared
def test_the_second_unit_alone_is_refused_with_its_reason(one_unit_drifts):
    recording, parameters, results = one_unit_drifts
    only = ComposeOptions(only=((Sensor.GYRO, 1),))
    plan = compose(results, parameters, fingerprint(recording.identity, parameters), options=only)
    assert not plan.changes
    assert "below what the stream resolves" in plan.blockers[0]


def test_a_simulated_unit_below_the_resolution_does_not_keep_the_other_one_from_being_written(bench):
    """The same in simulation: the second unit stands still within one step of a stream of 1 mrad/s."""
    moves = replace(bench().gyros[0], thermal=TRUTH)
    still = replace(moves, offset=(0.0004, -0.0003, 0.0002), thermal=np.zeros((3, 1)), noise=1e-6, quantum=1e-3)
    warm = bench(
        temperature=lambda t: 58.0 - 40.0 * np.exp(-(t - t[0]) / 40.0),
        accels=(replace(bench().accels[0], thermal=10.0 * TRUTH),) * 2,
        gyros=(replace(moves, noise=1e-4), still),
        rate=25.0,
    ).hold(150.0)
    parameters = {
        **{f"INS_{kind}{n}_CALTEMP": -300.0 for kind in ("ACC", "GYR") for n in (1, 2)},
        **{f"INS_{kind}{n}OFFS_{a}": 0.001 for kind in ("ACC", "GYR") for n in ("", 2) for a in "XYZ"},
        **{f"INS_ACC{n}SCAL_{a}": 1.0 for n in ("", 2) for a in "XYZ"},
        **{f"INS_{kind}{n}_ID": 77 for kind in ("ACC", "GYR") for n in ("", 2)},
        "INS_TCAL1_ENABLE": 0,
        "INS_TCAL2_ENABLE": 0,
        "AHRS_ORIENTATION": 0,
        "INS_GYR_CAL": 1,
    }
    identity = Identity("ardupilot", 2, (4, 7, 0), "0123", 1, 1)
    outcome = replay("thermal", {}, ProcedureContext(identity, parameters=parameters), warm.record(), [])
    assert isinstance(outcome, Done), outcome
    plan = compose(outcome.results, parameters, fingerprint(identity, parameters))
    assert not plan.blockers
    names = {c.name for c in plan.changes}
    assert "INS_TCAL1_GYR1_X" in names
    assert "INS_TCAL2_ENABLE" not in names
    assert any(text.startswith("gyro 2 is left out: its drift") and "resolves" in text for text in plan.warnings)

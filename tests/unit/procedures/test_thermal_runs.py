"""Jobs that were recorded against real firmwares, beside the truth."""

from __future__ import annotations

import lzma
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mavcal.calib.firmware.ardupilot import parameters as ardupilot
from mavcal.calib.firmware.compose.plan import ComposeOptions, compose
from mavcal.calib.firmware.in_force.fingerprint import fingerprint
from mavcal.calib.firmware.in_force.undo import undo
from mavcal.calib.firmware.px4 import parameters as px4
from mavcal.calib.firmware.values import retained
from mavcal.calib.logs.tlog import read_tlog
from mavcal.calib.procedures.protocol import Done
from mavcal.calib.procedures.registry import replay
from mavcal.calib.procedures.spec import ProcedureContext
from mavcal.calib.recording import Identity, ParameterTimeline, Recording, Sensor

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


@pytest.mark.long
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
    # the second accelerometer does not drift either: it passes too few edges between its bins for a curve
    assert any(text.startswith("accel 2 is left out: its drift with temperature is below") for text in plan.warnings)
    assert {(loss.sensor, loss.instance) for loss in plan.losses} == {(Sensor.ACCEL, 0)}
    assert all("CALTEMP does not say" in loss.text for loss in plan.losses)


@pytest.mark.shared
def test_the_second_unit_alone_is_refused_with_its_reason(one_unit_drifts):
    recording, parameters, results = one_unit_drifts
    only = ComposeOptions(only=((Sensor.GYRO, 1),))
    plan = compose(results, parameters, fingerprint(recording.identity, parameters), options=only)
    assert not plan.changes
    assert "below what the stream resolves" in plan.blockers[0]


@pytest.mark.long
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


PX4_GYRO = np.array([[1.636e-4, -8.6e-7, 0.0], [-3.735e-4, 7.4e-7, 0.0], [3.36e-4, -5.1e-7, 0.0]])
"""Drift of the gyro of px4_thermal_restart about 25 degC."""
WRITTEN = 270.0
"""s; the write of that run begins then."""


@pytest.fixture(scope="module")
def px4_warmed_up(shared_data: Path):
    """The capture of the job, the parameters before its write, and what the thermal job makes of it."""
    path = shared_data / "firmware_runs" / "px4_thermal_restart.tlog.xz"
    if not path.exists():
        pytest.skip(f"needs {path.name} beside the repository")
    whole = read_tlog(lzma.decompress(path.read_bytes()))
    entries = tuple(e for e in whole.parameters.entries if e.t < WRITTEN)
    channels = tuple(c.take(c.t < WRITTEN) for c in whole.channels)
    recording = Recording(channels, ParameterTimeline(entries), identity=whole.identity)
    parameters = recording.parameters.final()
    context = ProcedureContext(recording.identity, {Sensor.ACCEL: (0,), Sensor.GYRO: (0,)}, None, parameters)
    outcome = replay("thermal", {}, context, undo(recording), [])
    assert isinstance(outcome, Done), outcome
    return whole, parameters, outcome.results, fingerprint(recording.identity, parameters)


@pytest.mark.long
@pytest.mark.shared
def test_what_px4_did_not_keep_over_its_restart_is_not_written(px4_warmed_up):
    whole, parameters, results, of = px4_warmed_up
    lost = {e.name for e in whole.parameters.entries if 281.0 < e.t < 281.7 and e.name.startswith("TC_")}
    assert {"TC_G0_X3_0", "TC_G0_X3_1", "TC_G0_X3_2"} <= lost  # held 0 after the restart, and everything was taken back
    plan = compose(results, parameters, of)
    assert not plan.blockers
    assert not {"TC_G0_X3_0", "TC_G0_X3_1", "TC_G0_X3_2"} & {c.name for c in plan.changes}
    assert all(retained(c.name, float(c.new)) == c.new for c in plan.changes if c.kind == "real32")
    (loss,) = plan.losses
    assert (loss.sensor, loss.unit) == (Sensor.GYRO, "rad/s")
    assert loss.cost < 2e-4
    after = {**parameters, **{c.name: c.new for c in plan.changes}}
    held = px4.calibration_in_force(after, Sensor.GYRO, 0)
    assert held.polynomial is not None
    d = np.linspace(10.0, 57.0, 40)
    truth = (d - 25.0)[:, None] ** np.arange(1, 4) @ PX4_GYRO.T
    curve = held.polynomial(d) + held.offset
    apart = curve - truth - (curve - truth)[16]
    assert np.abs(apart).max() < 2e-4  # 0.01 deg/s over 47 degC

"""What the motors were told: the mixer rebuilt from its inputs, checked on outputs, and PX4's curve undone."""

from __future__ import annotations

import numpy as np
import pytest

from mavcal.calib.airframe.commands import AGREES_US, commands_of
from mavcal.calib.airframe.geometry import geometry_of
from mavcal.calib.recording import Identity, ParameterTimeline, Recording, Sensor, Stage
from tests.unit.airframe.made import AP, frame, stream

FACTORS = np.array([(-0.5, 0.5, 0.5), (0.5, -0.5, 0.5), (0.5, 0.5, -0.5), (-0.5, -0.5, -0.5)])
"""Roll, pitch and yaw of each motor of a quad X (AIRFRAME 3.1)."""
PARAMETERS = {
    "FRAME_CLASS": 1, "FRAME_TYPE": 1, "MOT_THST_EXPO": 0.65, "MOT_SPIN_MIN": 0.15, "MOT_SPIN_MAX": 0.95,
    "MOT_PWM_MIN": 1100, "MOT_PWM_MAX": 1900,
}  # fmt: skip


ALTERNATELY = np.array([1.0, -1.0, 1.0, -1.0])
"""An error of the outputs that no density of the air explains."""


def pulses(inputs: np.ndarray, lift: float, volt: float, expo: float, density: float) -> tuple[np.ndarray, np.ndarray]:
    """Commands and pulses, us: the formulas of AIRFRAME 3.1 step by step."""
    out, pwm = [], []
    for roll, pitch, yaw, throttle in inputs:
        c_of_motor = []
        for rf, pf, yf in FACTORS:
            th = max((throttle + roll * rf + pitch * pf + yaw * yf) / lift / density, 0.0)
            if expo == 0.0:
                c = lift * th / volt
            else:
                c = ((expo - 1.0) + np.sqrt((1.0 - expo) ** 2 + 4.0 * expo * lift * th)) / (2.0 * expo) / volt
            c_of_motor.append(c)
        out.append(c_of_motor)
        pwm.append([1100 + 800 * (0.15 + 0.8 * min(max(c, 0.0), 1.0)) for c in c_of_motor])
    return np.array(out), np.array(pwm)


def signals(seconds: float = 12.0) -> tuple[np.ndarray, np.ndarray]:
    t = np.arange(0.0, seconds, 0.0025)
    roll, pitch = 0.1 * np.sin(3.0 * t), 0.08 * np.cos(2.0 * t)
    return t, np.column_stack([roll, pitch, 0.03 * np.sin(t), 0.35 + 0.05 * np.sin(0.7 * t)])


def flown(
    *,
    expo: float = 0.65,
    lift: float = 0.93,
    volt: float = 0.96,
    density: float = 1.0,
    limit: float = 1.0,
    altitude: float | None = None,
    off_us: float = 0.0,
    inputs: np.ndarray | None = None,
    seconds: float = 12.0,
) -> tuple[Recording, np.ndarray]:
    """A log of RATE and MOTB with the outputs at 10 Hz, and the commands at loop rate."""
    t, usual = signals(seconds)
    inputs = usual if inputs is None else inputs
    c, pwm = pulses(inputs, lift, volt, expo, density)
    rows = slice(None, None, 40)
    logged = (np.floor(pwm[rows]) + off_us * ALTERNATELY - 1100.0) / 800.0
    channels = [stream(Sensor.MOTOR, t[rows], logged, source="RCOU", stage=Stage.RAW)]
    if altitude is not None:
        place = np.tile([0.0, 0.0, altitude], (len(t[rows]), 1))
        channels.append(stream(Sensor.POSITION, t[rows], place, source="GPS", stage=Stage.RAW))
    dynamics = (
        stream(Sensor.CONTROL, t, inputs, source="RATE", stage=Stage.RAW),
        stream(Sensor.MIXER, t[rows], np.tile([lift, volt, limit], (len(t[rows]), 1)), source="MOTB", stage=Stage.RAW),
    )
    parameters = ParameterTimeline.constant({**PARAMETERS, "MOT_THST_EXPO": expo})
    return Recording(tuple(channels), parameters, identity=AP, dynamics=dynamics), c


@pytest.mark.parametrize("expo", [0.65, 0.3, 0.0, 1.0, -0.4])
def test_the_mixer_is_rebuilt_at_loop_rate(expo: float) -> None:
    recording, known = flown(expo=expo)
    found = commands_of(recording, frame())
    assert found is not None
    assert found.source == "rate_mixer"
    assert found.rate_hz == pytest.approx(400.0)
    assert found.check_us is not None
    assert found.check_us < 1.0  # outputs are cut to whole microseconds
    assert not found.limited.any()
    np.testing.assert_allclose(found.c, known, atol=1e-9)


def test_a_mixer_that_corrects_for_density_is_told_from_one_that_does_not() -> None:
    """By that of the standard atmosphere, 0.8217 at 2000 m, or as ArduPilot did until 4.5: by a warm barometer's."""
    for density in (1.0, 0.8217, 0.755):
        recording, known = flown(density=density, altitude=2000.0)
        found = commands_of(recording, frame())
        assert found is not None
        assert found.source == "rate_mixer"
        np.testing.assert_allclose(found.c, known, atol=2e-3)


@pytest.mark.parametrize(("off_us", "source"), [(AGREES_US - 1.5, "rate_mixer"), (AGREES_US + 1.5, "rcou")])
def test_outputs_that_deny_the_mixer_are_believed(off_us: float, source: str) -> None:
    recording, known = flown(off_us=off_us)
    found = commands_of(recording, frame())
    assert found is not None
    assert found.source == source
    if source == "rcou":
        assert found.rate_hz == pytest.approx(10.0)
        assert found.check_us is None
        np.testing.assert_allclose(found.c, known[::40] + off_us * ALTERNATELY / 640.0, atol=1.01 / 640.0)


def test_a_mixer_of_another_frame_is_not_believed() -> None:
    recording, _ = flown()
    found = commands_of(recording, frame("quad-plus"))
    assert found is not None
    assert found.source == "rcou"


def test_five_seconds_of_outputs_are_needed_to_believe_a_mixer() -> None:
    recording, _ = flown(seconds=4.0)
    found = commands_of(recording, frame())
    assert found is not None
    assert found.source == "rcou"


def test_rows_at_a_limit_are_marked() -> None:
    """No thrust left, too much of it, a turn wider than the range, and a thrust limit."""
    t, inputs = signals()
    wrong = {2.0: (0.9, 0.0, 0.0, 0.2), 4.0: (0.3, 0.3, 0.3, 0.95), 6.0: (0.9, 0.9, 0.0, 0.5)}
    expected = np.zeros(len(t), dtype=bool)
    for start, values in wrong.items():
        rows = (t >= start) & (t < start + 0.1)
        inputs[rows], expected = values, expected | rows
    recording, known = flown(inputs=inputs, lift=1.0, volt=1.0)
    found = commands_of(recording, frame())
    assert found is not None
    assert found.source == "rate_mixer"
    np.testing.assert_array_equal(found.limited, expected)
    np.testing.assert_allclose(found.c[~expected], known[~expected], atol=1e-9)
    assert (found.c.min(), found.c.max()) >= (0.0, 0.0)
    assert found.c.max() <= 1.0
    limited = commands_of(flown(limit=0.9)[0], frame())
    assert limited is not None
    assert limited.limited.all()


def of_px4(values: np.ndarray, **parameters: float) -> Recording:
    t = np.arange(len(values)) / 250.0
    motor = stream(Sensor.MOTOR, t, values, source="actuator_motors", stage=Stage.RAW)
    return Recording((motor,), ParameterTimeline.constant(parameters), identity=Identity(autopilot="px4"))


@pytest.mark.parametrize("factor", [0.0, 0.3, 0.8, 1.0])
def test_the_curve_of_px4_is_undone(factor: float) -> None:
    """Thrust = f x^2 + (1 - f) x, which the outputs undo (``FunctionMotors.hpp``)."""
    x = np.linspace(0.01, 0.99, 200)[:, None] * np.ones(4)
    found = commands_of(of_px4(factor * x**2 + (1.0 - factor) * x, THR_MDL_FAC=factor), frame())
    assert found is not None
    assert found.source == "actuator_motors"
    assert found.rate_hz == pytest.approx(250.0)
    np.testing.assert_allclose(found.c, x, atol=1e-12)
    assert not found.limited.any()


def test_a_motor_of_px4_at_an_end_is_at_its_limit() -> None:
    values = np.full((100, 4), 0.5)
    values[10, 2], values[20, 0] = 0.0, 1.0
    found = commands_of(of_px4(values), frame())
    assert found is not None
    assert np.flatnonzero(found.limited).tolist() == [10, 20]


def test_a_recording_without_commands_or_with_too_few_or_too_many_has_none() -> None:
    hexa = geometry_of({}, "hexa-x")
    assert hexa is not None
    assert commands_of(Recording((), identity=AP), frame()) is None
    assert commands_of(of_px4(np.full((100, 4), 0.5)), hexa) is None
    t = np.linspace(0.0, 1.0, 100)
    more = np.column_stack([np.full((100, 4), 0.5), 0.5 + 0.1 * t, 0.5 - 0.1 * t])
    assert commands_of(of_px4(more), frame()) is None
    unused = np.column_stack([np.full((100, 4), 0.5), np.zeros((100, 4))])
    assert commands_of(of_px4(unused), frame()) is not None

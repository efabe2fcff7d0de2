"""What the day did: jumps of the estimator, and air that every unit feels."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mavcal.calib.airframe.air import JUMP, Jump, Turbulence, glitches, jumps, outside, turbulence
from mavcal.calib.airframe.flown import FlownFlight
from mavcal.calib.earth import SEMI_MAJOR_AXIS_M
from mavcal.calib.recording import Channel, ParameterTimeline, Recording, Sensor, Stage
from tests.unit.airframe.made import HZ, G, airframe, flight, hover, stream

N = 3000


def moving(heading_deg: float = 0.0, over_s: float = 0.0, **velocity_steps: float) -> FlownFlight:
    """Swings by 3 m/s with the force that this needs; besides, the estimator's velocity changes by `at_<s>` m/s.

    `over_s`: the time that each change takes, s.
    """
    t = np.arange(N) / HZ
    speed = np.column_stack([3.0 * np.sin(0.6 * t), 2.0 * np.cos(0.4 * t), 0.5 * np.sin(0.9 * t)])
    turn = Rotation.from_euler("ZYX", [heading_deg, 10.0, -5.0], degrees=True)
    local = np.gradient(speed, 1.0 / HZ, axis=0) - [0.0, 0.0, G]
    told = speed.copy()
    for name, size in velocity_steps.items():
        part = np.clip((t - float(name.removeprefix("at_"))) / max(over_s, 1e-9), 0.0, 1.0)
        told += part[:, None] * [size * 0.6, size * 0.8, 0.0]
    q = np.tile(turn.as_quat(scalar_first=True), (N, 1))
    return flight(hover(N / HZ), velocity=told, q=q, force=turn.inv().apply(local))


def found(one: FlownFlight) -> tuple[Jump, ...]:
    return jumps(one, airframe(one, torque=False).body_from_local)


@pytest.mark.parametrize("heading_deg", [0.0, 130.0])
def test_a_flight_whose_force_explains_its_velocity_has_no_jump(heading_deg: float) -> None:
    one = moving(heading_deg)
    assert found(one) == ()
    assert outside(one, ()).all()


def test_a_reset_of_the_estimator_is_found_with_its_time_and_size() -> None:
    one = moving(40.0, at_20=-0.9, at_10=1.5)
    first, second = found(one)
    assert (first.t, second.t) == (pytest.approx(10.0, abs=0.25), pytest.approx(20.0, abs=0.25))
    assert (first.size, second.size) == (pytest.approx(1.5, abs=0.05), pytest.approx(0.9, abs=0.05))
    kept = outside(one, (first, second))
    assert not kept[np.abs(one.t - first.t) < 1.4].any()
    assert kept[np.minimum(np.abs(one.t - first.t), np.abs(one.t - second.t)) > 1.6].all()


def test_across_a_hole_of_the_log_nothing_is_a_reset() -> None:
    one = moving(40.0, at_20=-0.9, at_10=1.5)
    holed = dataclasses.replace(one, usable=one.usable & ~((one.t > 9.0) & (one.t < 11.0)))
    (second,) = found(holed)
    assert second.t == pytest.approx(20.0, abs=0.25)
    limited = dataclasses.replace(one, usable=one.usable & (one.t < 19.0), limited=one.limited | (one.t >= 19.0))
    assert len(found(limited)) == 2  # a command at its limit hides no velocity


def test_a_velocity_of_the_gps_is_left_out_where_it_jumps_and_is_no_reset() -> None:
    gps_only = dataclasses.replace(moving(40.0, at_20=-0.9), estimated=False)
    (left_out,) = found(gps_only)
    assert not left_out.sudden


def test_a_drift_of_the_estimator_is_left_out_and_is_no_reset() -> None:
    """PX4's corrects its heading in the first fast start; it was told as a reset of 0.8 m/s."""
    (drift,) = found(moving(40.0, 0.6, at_10=1.1))
    assert not drift.sudden
    assert all(reset.sudden for reset in found(moving(40.0, 0.1, at_20=-0.9, at_10=1.5)))


def test_what_an_estimator_does_every_day_is_no_jump() -> None:
    assert found(moving(at_12=0.8 * JUMP)) == ()


def gusts(seed: int, size: float) -> np.ndarray:
    """Coloured noise of 0.1 to 2 Hz with about this root mean square."""
    rng = np.random.default_rng(seed)
    made = np.cumsum(rng.normal(size=(N, 3)), axis=0)
    made -= np.array([np.convolve(m, np.ones(300) / 300.0, mode="same") for m in made.T]).T
    return size * made / made.std()


def test_air_is_felt_by_both_units() -> None:
    air = gusts(1, 0.3)
    base = np.tile([0.0, 0.0, -G], (N, 1))
    rng = np.random.default_rng(2)
    one = flight(hover(N / HZ), force=base + air, others={1: base + air + 0.02 * rng.normal(size=(N, 3))})
    calm = flight(hover(N / HZ))
    made = turbulence(one, air, calm, gusts(3, 0.01))
    assert made.shared is not None
    assert made.shared > 0.95
    assert made.real == pytest.approx(0.3 * np.sqrt(2.0 / 3.0), rel=0.3)
    assert made.sim == pytest.approx(0.01, rel=0.3)
    assert made.of_air


def test_noise_of_one_unit_is_not_of_the_air() -> None:
    own = gusts(4, 0.3)
    base = np.tile([0.0, 0.0, -G], (N, 1))
    one = flight(hover(N / HZ), force=base + own, others={1: base + gusts(5, 0.02)})
    made = turbulence(one, own, flight(hover(N / HZ)), gusts(3, 0.01))
    assert made.shared is not None
    assert abs(made.shared) < 0.3
    assert not made.of_air


def test_rows_that_are_not_judged_take_no_part() -> None:
    force = gusts(1, 0.1)
    usable = np.ones(N, dtype=bool)
    usable[1000:1400] = False
    open_force = force.copy()
    open_force[1000:1400] = np.nan
    one = flight(hover(N / HZ), usable=usable)
    made = turbulence(one, open_force, one, open_force)
    assert np.isfinite(made.real)
    assert made.real == made.sim
    assert made.shared is None
    assert not made.of_air


@pytest.mark.parametrize(
    ("made", "of_air"),
    [
        (Turbulence(0.3, 0.1, 0.9), True),
        (Turbulence(0.3, 0.1, None), True),  # one unit only: nothing speaks against it
        (Turbulence(0.3, 0.1, 0.2), False),
        (Turbulence(0.15, 0.1, 0.9), False),
        (Turbulence(0.01, 0.001, 0.9), False),  # what an estimator leaves open
    ],
)
def test_the_air_is_named_where_it_is_louder_and_shared(made: Turbulence, of_air: bool) -> None:
    assert made.of_air is of_air


def gps(step_m: float = 0.0) -> Recording:
    """Circles of 3 m/s about a place in the south; from 12 to 20 s the place is wrong by `step_m` to the east."""
    t = np.arange(0.0, 30.0, 0.2)
    velocity = 3.0 * np.column_stack([np.cos(0.5 * t), np.sin(0.5 * t), 0.0 * t])
    place = 6.0 * np.column_stack([np.sin(0.5 * t), 1.0 - np.cos(0.5 * t)])
    place[:, 1] += np.where((t >= 12.0) & (t < 20.0), step_m, 0.0)
    degrees = np.degrees(place / SEMI_MAJOR_AXIS_M) / [1.0, np.cos(np.radians(-35.0))] + [-35.0, 149.0]
    values = np.column_stack([degrees, 0.0 * t])
    made = (
        stream(Sensor.POSITION, t, values, source="GPS", stage=Stage.RAW),
        stream(Sensor.VELOCITY, t, velocity, source="GPS", stage=Stage.RAW),
    )
    return Recording(made, ParameterTimeline.constant({}), ())


def kept_rows(channel: Channel, rows: np.ndarray) -> Channel:
    return dataclasses.replace(channel, t=channel.t[rows], values=channel.values[rows])


def test_a_place_that_jumps_beside_its_velocity_is_a_glitch_of_the_gps() -> None:
    assert glitches(gps(), 0.0, 30.0) == ()
    gone, back = glitches(gps(22.0), 0.0, 30.0)
    assert (gone.t, back.t) == (pytest.approx(12.0, abs=0.3), pytest.approx(20.0, abs=0.3))
    assert gone.size == pytest.approx(22.0, rel=0.05)
    assert glitches(gps(22.0), 13.0, 19.0) == ()
    slow = tuple(kept_rows(c, np.arange(len(c.t)) % 5 == 0) for c in gps(22.0).channels)
    assert len(glitches(gps().with_channels(slow), 0.0, 30.0)) == 2  # once a second
    holed = tuple(kept_rows(c, (c.t < 11.0) | (c.t > 14.0)) for c in gps(22.0).channels)
    (only,) = glitches(gps().with_channels(holed), 0.0, 30.0)
    assert only.t == pytest.approx(20.0, abs=0.3)
    assert glitches(Recording((), ParameterTimeline.constant({}), ()), 0.0, 30.0) == ()

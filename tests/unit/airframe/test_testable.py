"""Which effects two flights can show: each reason has its number, its vehicle and what to do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mavcal.calib.airframe.effects import IDS
from mavcal.calib.airframe.fit import FlightLikelihood
from mavcal.calib.airframe.flown import LOG_BITS, PROFILE_BITS, FlownFlight
from mavcal.calib.airframe.testable import TORQUE_IDS, missing, unusable
from tests.unit.airframe.made import HZ, airframe, flight

N = 6000


def lively() -> FlownFlight:
    """A minute with all that an airframe shows: doublets, throttle steps, runs of 9 m/s, climbs, an emptied battery."""
    t = np.arange(N) / HZ
    rng = np.random.default_rng(1)
    c = 0.5 + 2e-4 * rng.normal(size=(N, 4))
    turning = np.array([-1.0, 1.0, 1.0, -1.0])
    for start in (5.0, 25.0):
        rows = (t > start) & (t < start + 4.0)
        c[rows] += 0.1 * np.sign(np.sin(8.0 * t[rows]))[:, None] * turning
    lifts = (t > 40.0) & (t < 50.0)
    c[lifts] += 0.15 * np.sign(np.sin(3.0 * t[lifts]))[:, None]
    velocity = np.column_stack([9.0 * np.sin(0.4 * t), 9.0 * np.cos(0.4 * t), 2.5 * np.sin(0.7 * t)])
    rate = np.sin(np.outer(t, [8.0, 7.0, 2.0]))
    return flight(c, velocity=velocity, voltage=np.linspace(12.6, 11.0, N), rate=rate)


def likelihood(one: FlownFlight, *, torque: bool = True) -> FlightLikelihood:
    return FlightLikelihood(airframe(one, torque=torque), one.usable, torque=torque)


def reasons(
    real: FlownFlight, sim: FlownFlight | None = None, wind: tuple[float, float] = (0.0, 0.0)
) -> dict[str, tuple[str, str]]:
    winds = np.array(wind), np.array(wind)
    found = missing(likelihood(real), likelihood(real if sim is None else sim), winds)
    assert all(m.reason and m.need for m in found)
    return {m.id: (m.reason, m.need) for m in found}


def test_a_flight_with_everything_lacks_only_what_no_flight_shows() -> None:
    assert reasons(lively()) == {}
    assert unusable(likelihood(lively())) is None


def test_ids_are_those_of_the_catalogue() -> None:
    still = replace(lively(), velocity=np.zeros((N, 3)), c=np.full((N, 4), 0.5), command_hz=10.0)
    assert set(reasons(still)) <= IDS
    assert set(TORQUE_IDS) <= IDS


@pytest.mark.parametrize(
    ("id_", "changes", "said"),
    [
        ("rotor_drag", {"velocity": 0.1}, "at 0.9 m/s"),
        ("body_drag", {"velocity": 0.6}, "reaches 5.4 m/s"),
        ("translational_lift", {"velocity": 0.6}, "reaches 5.4 m/s"),
        ("inflow", {"velocity": 0.1}, "climbs at 0.2 m/s"),
        ("battery_sag", {"voltage": 12.0}, "changes by 0.0 %"),
        ("battery_sag", {"voltage": np.nan}, "has no voltage"),
        ("inertia", {"c": 0.5}, "turn in 0 %"),
        ("motor_lag", {"c": 0.5}, "turn in 0 %"),
        ("thrust_expo", {"c": 0.5}, "spans 0.00"),
        ("thrust_expo", {"command_hz": 10.0}, "at 10 Hz"),
        ("motor_weak", {"command_hz": 50.0}, "at 50 Hz"),
        ("inertia", {"inertial_hz": 25.0}, "at 25 Hz"),
    ],
)
@pytest.mark.parametrize("which", ["real", "simulated"])
def test_what_is_missing_is_said_with_its_number(id_: str, changes: dict, said: str, which: str) -> None:
    one = lively()
    ((name, value),) = changes.items()
    made = one.velocity * value if name == "velocity" else np.full_like(getattr(one, name), value)
    made = float(made) if name.endswith("_hz") else made
    less = replace(one, **{name: made})
    found = reasons(less, one) if which == "real" else reasons(one, less)
    if id_ == "battery_sag" and which == "simulated" and value == 12.0:  # a simulator may be without a battery
        assert id_ not in found
        return
    reason, need = found[id_]
    assert said in reason
    assert which in reason or said == "changes by 0.0 %"
    assert need


@pytest.mark.parametrize(("axis", "name"), [("x", "roll"), ("y", "pitch"), ("z", "yaw")])
def test_an_axis_that_hardly_turns_is_not_judged_and_the_others_are(axis: str, name: str) -> None:
    """The beginning of a log, with doublets in roll alone, had 1.75 times the inertia in pitch at over 99 %."""
    one = lively()
    rate = one.rate * np.where(np.array(["x", "y", "z"]) == axis, 0.03, 1.0)
    winds = np.zeros(2), np.zeros(2)
    found = missing(likelihood(replace(one, rate=rate)), likelihood(one), winds)
    assert [(m.id, m.axes) for m in found if m.id == "inertia"] == [("inertia", (axis,))]
    assert f"the real vehicle turns in {name} at 0.03 rad/s" in found[0].reason
    assert ("yaw_coefficient" in {m.id for m in found}) is (axis == "z")


def test_drag_by_the_square_asks_for_speed_through_the_air() -> None:
    """Against 4 m/s of wind, 5.4 m/s over the ground are enough."""
    slow = replace(lively(), velocity=0.6 * lively().velocity)
    assert {"body_drag", "translational_lift"} <= set(reasons(slow))
    assert reasons(slow, wind=(4.0, 0.0)) == {}


def test_what_too_little_movement_hides_may_be_there_all_the_same() -> None:
    slow = replace(lively(), velocity=0.1 * lively().velocity, voltage=np.full(N, 12.0), command_hz=10.0)
    still = np.zeros(2)
    latent = {m.id: m.latent for m in missing(likelihood(slow), likelihood(lively()), (still, still))}
    assert {id_ for id_, one in latent.items() if one} == {"rotor_drag", "body_drag", "translational_lift", "inflow"}


def test_slow_commands_hide_all_that_turns_and_say_how_to_log() -> None:
    slow = replace(lively(), command_hz=10.0)
    found = reasons(slow)
    assert set(TORQUE_IDS) <= set(found)
    assert LOG_BITS in found["inertia"][1]
    assert PROFILE_BITS in reasons(replace(slow, ardupilot=False))["inertia"][1]


@pytest.mark.parametrize(("part", "usable"), [(0.1, True), (0.3, False)])
def test_a_flight_that_is_at_its_limits_says_nothing(part: float, usable: bool) -> None:
    limited = np.arange(N) < part * N
    reason = unusable(likelihood(replace(lively(), limited=limited)))
    assert (reason is None) is usable
    if reason is not None:
        assert "30 %" in reason

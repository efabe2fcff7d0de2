"""Two flights to an answer, end to end: the flying simulated vehicle with one thing changed."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mavcal.calib.airframe.answer import AirframePart, Domain
from mavcal.calib.airframe.diagnose import airframe_alone, airframe_gap
from mavcal.calib.airframe.effects import IDS
from mavcal.calib.airframe.found import AirframeAnswer, NoAirframe
from mavcal.calib.blind.airframe.cases import AirTier, make_air_case
from mavcal.calib.recording import ParameterTimeline, Recording, Sensor
from tests.unit.airframe.flights import flight

CORNER = math.sqrt(0.5)
X = ((CORNER, CORNER), (-CORNER, -CORNER), (CORNER, -CORNER), (-CORNER, CORNER))
"""Places of a quad X, in arms of 0.35 m."""


def same_body_drag(factor: float) -> dict[str, float]:
    """Rotors with so many times the drag, and a reference speed at which the body's stays (``SIM_Frame.cpp``)."""
    rho, weight, coefficient, speed = 1.1567, 3.0 * 9.80665, 0.2, 15.08
    by_speed = math.sqrt(rho * 0.385 * weight / CORNER) * 0.5
    body = (weight - coefficient * by_speed * speed) / speed**2
    linear = factor * coefficient * by_speed
    solved = (-linear + math.sqrt(linear**2 + 4.0 * body * weight)) / (2.0 * body)
    return {"mdrag_coef": factor * coefficient, "refSpd": solved}


def shifted(forward_m: float, right_m: float) -> dict[str, list[float]]:
    return {
        f"motor{n}_position": [0.35 * x - forward_m, 0.35 * y - right_m, 0.0] for n, (x, y) in enumerate(X, start=1)
    }


def diagnosed(real: Recording, sim: Recording, **options: Any) -> AirframeAnswer:
    found = airframe_gap(real, sim, **options)
    assert isinstance(found, AirframeAnswer), found
    return found


def airframes(answer: AirframeAnswer) -> set[str]:
    return {f.id for f in answer.found if f.domain is Domain.AIRFRAME}


def agrees(answer: AirframeAnswer, id_: str, known: Mapping[str, float], least_sd: float = 0.005) -> None:
    """Every parameter within three of its standard errors; a part of a per cent is the firmwares' rounding."""
    (found,) = (f for f in answer.found if f.id == id_)
    values = {v.name: v for v in found.values}
    assert set(known) <= set(values)
    for name, value in known.items():
        assert abs(values[name].value - value) < 3.0 * max(values[name].sd, least_sd)


def test_a_second_flight_of_the_same_vehicle_on_another_day_shows_wind_only(
    usual: Recording, simulated: Recording
) -> None:
    answer = diagnosed(usual, simulated)
    assert [f.id for f in answer.found] == ["wind"]
    agrees(answer, "wind", {"north": 2.0 * math.cos(math.radians(20.0)), "east": 2.0 * math.sin(math.radians(20.0))})
    assert answer.part.wind == pytest.approx((1.879, 0.684), abs=0.3)
    assert (answer.unknown, answer.unknown_share) == ("", 0.0)
    assert answer.nameless < 0.1
    assert {m.id for m in answer.missing} == {"ground_effect", "air_density", "battery_sag"}
    assert answer.part.probabilities["wind"] > 0.99
    assert max(p for id_, p in answer.part.probabilities.items() if id_ != "wind") < 0.5
    assert answer.jumps == ()
    assert answer.part.geometry is not None
    assert (answer.part.geometry.frame_type, answer.part.geometry.source) == ("x", "parameters")
    commands = answer.part.commands
    assert commands is not None
    assert (commands.source, commands.rate_hz) == ("rate_mixer", 400.0)
    assert commands.check_us is not None
    assert commands.check_us < 1.5
    assert commands.masked < 0.07
    # the frame's own numbers: g / 0.39, its curve and its drag
    assert answer.part.facts["k"] == pytest.approx(25.145, rel=0.01)
    assert answer.part.facts["expo"] == pytest.approx(0.65, abs=0.02)
    assert answer.part.facts["c1"] == pytest.approx(0.2413, rel=0.1)
    for trace in answer.part.traces:
        assert trace.real.shape == trace.sim.shape == trace.patched.shape == (len(trace.t), 3)


def test_a_weak_motor_is_named_with_its_number_and_thrust(tmp_path: Path, simulated: Recording) -> None:
    """A multiplier of 0.96 takes 8 % of the thrust at the hover command; motor 3 is bit 2."""
    real = flight(tmp_path / "x.bin", other=True, SIM_ENGINE_FAIL=4.0, SIM_ENGINE_MUL=0.96)
    answer = diagnosed(real, simulated)
    assert airframes(answer) == {"motor_weak"}
    (found,) = answer.found
    assert found.motors == (3,)
    assert found.probability > 0.95
    agrees(answer, "motor_weak", {"s": -0.079, "motor": 3.0})
    assert answer.nameless < 0.1
    rates = [r for r in answer.part.rollout if r.quantity == "body_rate" and r.part == "blocks"]
    assert rates
    assert all(r.closed is not None and r.closed > 0.8 for r in rates)
    assert answer.heldout is not None
    assert answer.heldout.after < 0.1 * answer.heldout.before


@pytest.mark.long
def test_thrust_may_be_the_batterys_where_no_voltage_was_logged(tmp_path: Path, simulated: Recording) -> None:
    real = flight(tmp_path / "x.bin", {"hoverThrOut": 0.39 / 0.9}, other=True)
    real = replace(real, dynamics=tuple(c for c in real.dynamics if c.sensor is not Sensor.VOLTAGE))
    answer = diagnosed(real, simulated)
    (found,) = (f for f in answer.found if f.id == "thrust_scale")
    assert "battery_sag" in {r.id for r in found.rivals}
    (gone,) = (m for m in answer.missing if m.id == "battery_sag")
    assert gone.reason == "the real recording has no voltage of the battery"


CASES: dict[str, tuple[Mapping[str, Any], Mapping[str, float], str, Mapping[str, float]]] = {
    "thrust": ({"hoverThrOut": 0.39 / 0.9}, {}, "thrust_scale", {"s": -0.1}),
    "curve": ({"propExpo": 0.5}, {}, "thrust_expo", {"expo": -0.15}),
    "drag": (same_body_drag(1.6), {"SIM_WIND_SPD": 1.0}, "rotor_drag", {"c1": 0.6}),
    "inertia": ({"moment_inertia": [0.0287, 0.0287, 0.0459]}, {}, "inertia", {"x": 0.249, "y": 0.249}),
    "centre": (shifted(0.012, -0.007), {}, "cg_offset", {"x": 0.0343, "y": -0.02}),
    "battery": ({"battCapacityAh": 0.6, "refBatRes": 0.03}, {}, "battery_sag", {"exponent": 2.0}),
    "lag": ({"motorTau": 0.05}, {}, "motor_lag", {"tau_up": 0.05}),
    "rate limit": ({"slew_max": 1.2}, {}, "motor_lag", {"slew": 1.2}),
}


@pytest.mark.long
@pytest.mark.parametrize("name", sorted(CASES))
def test_what_was_changed_is_named_with_its_size(tmp_path: Path, simulated: Recording, name: str) -> None:
    frame, parameters, id_, known = CASES[name]
    real = flight(tmp_path / "x.bin", frame, other=True, **parameters)
    answer = diagnosed(real, simulated)
    assert airframes(answer) == {id_}
    agrees(answer, id_, known)
    assert answer.nameless < 0.5
    assert next(f for f in answer.found if f.id == id_).probability > 0.9


def test_the_damping_of_turns_is_that_of_the_rotors(usual: Recording, simulated: Recording) -> None:
    """In either order of a flight: filters that were written for the grid's rate made 1.6 or 2.1 of it.

    By the drag of the rotors, c1 m y^2 / I_x, and 400 deg/s by refRotRate (``SIM_Frame.cpp``).
    """
    known = 0.2413 * 3.0 * (0.35 * CORNER) ** 2 / 0.02296 + math.radians(400.0) / 120.0
    for recording in (usual, simulated):
        part = airframe_alone(recording)
        assert isinstance(part, AirframePart)
        for name in ("damping_x", "damping_y"):
            assert part.facts[name] == pytest.approx(known, rel=0.12)


FOREIGN = {
    "lag up and down": (6, "motor_lag", {"tau_up": -0.0138, "tau_down": -0.0197}),
    "yaw": (19, "yaw_coefficient", {"s": 0.604}),
    "load": (23, "payload_step", {"s": -0.2122}),
    "drag beside flapping, which was an inertia": (9940014, "body_drag", {"c2": 0.521}),
}
"""Seeds of the withheld-effect check's physics, development seeds, and what they hold."""


@pytest.mark.long
@pytest.mark.parametrize("name", sorted(FOREIGN))
def test_what_another_physics_changed_is_named_with_its_size(name: str) -> None:
    seed, id_, known = FOREIGN[name]
    answer = diagnosed(*make_air_case(AirTier.SINGLE, seed).recordings())
    assert airframes(answer) == {id_}
    agrees(answer, id_, known)


@pytest.mark.long
def test_a_name_that_is_left_out_of_the_catalogue_is_no_other_one(tmp_path: Path, simulated: Recording) -> None:
    """Without the centre of mass, a trim that goes with the thrust has no name, or an honest rival."""
    real = flight(tmp_path / "x.bin", shifted(0.012, -0.007), other=True)
    answer = diagnosed(real, simulated, without={"cg_offset"})
    assert "cg_offset" not in {f.id for f in answer.found}
    assert airframes(answer) <= {"motor_weak", "torque_bias"}
    assert airframes(answer) or answer.unknown


@pytest.mark.long
def test_turbulence_is_of_the_air(tmp_path: Path, simulated: Recording) -> None:
    real = flight(tmp_path / "x.bin", other=True, SIM_WIND_SPD=2.0, SIM_WIND_TURB=0.8)
    answer = diagnosed(real, simulated)
    assert airframes(answer) == set()
    assert answer.turbulence is not None
    assert answer.turbulence.of_air


def slow(recording: Recording) -> Recording:
    """As with the default log: outputs at 10 Hz, and no inputs of the mixer."""
    left = tuple(c for c in recording.dynamics if c.sensor not in (Sensor.CONTROL, Sensor.MIXER))
    return replace(recording, dynamics=left)


def test_out_of_time_it_answers_with_nothing_found(usual: Recording, simulated: Recording) -> None:
    answer = diagnosed(slow(usual), slow(simulated), ended=lambda: True)
    assert answer.found == ()


def test_a_slow_log_tells_of_force_and_says_what_it_lacks(usual: Recording, simulated: Recording) -> None:
    answer = diagnosed(slow(usual), slow(simulated))
    assert airframes(answer) == set()
    assert {"inertia", "motor_weak", "cg_offset", "thrust_expo"} <= {m.id for m in answer.missing}
    assert answer.part.commands is not None
    assert (answer.part.commands.source, answer.part.commands.rate_hz) == ("rcou", 10.0)
    assert {t.kind for t in answer.part.traces} == {"force"}
    assert all(r.quantity == "velocity" for r in answer.part.rollout)


def refused(real: Recording, sim: Recording, **options: Any) -> NoAirframe:
    found = airframe_gap(real, sim, **options)
    assert isinstance(found, NoAirframe)
    assert found.need
    return found


def parameters(recording: Recording, **changes: float) -> Recording:
    kept = {**recording.parameters.final(), **changes}
    return replace(recording, parameters=ParameterTimeline.constant(kept))


def test_why_nothing_can_be_said_is_said_of_the_right_flight(usual: Recording, simulated: Recording) -> None:
    tricopter = parameters(usual, FRAME_CLASS=7.0)
    reason = refused(tricopter, simulated)
    assert reason.reason.startswith("real recording: no multicopter frame")
    assert "--frame" in reason.need
    assert refused(usual, parameters(simulated, FRAME_CLASS=7.0)).reason.startswith("simulated recording")
    mute = simulated.with_channels(c for c in simulated.channels if c.sensor != Sensor.MOTOR)
    assert refused(usual, mute).reason == "simulated recording: no commands of the motors are logged"
    assert "LOG_BITMASK" in refused(usual, mute).need
    start, end = usual.span
    assert "in the air" in refused(usual.between(start, start + 0.5 * (end - start)), simulated).reason


def test_vehicles_of_different_frames_are_not_compared(usual: Recording, simulated: Recording) -> None:
    """A simulator with six motors: its outputs have six columns."""
    (motor,) = (c for c in simulated.channels if c.sensor == Sensor.MOTOR)
    six = replace(motor, values=np.tile(motor.values[:, :2], (1, 3)))
    others = tuple(c for c in simulated.channels if c.sensor != Sensor.MOTOR)
    hexa = parameters(simulated.with_channels((*others, six)), FRAME_CLASS=2.0)
    assert "4 and 6 motors" in refused(usual, hexa).reason


@pytest.mark.long
def test_every_name_is_of_the_catalogue(usual: Recording, simulated: Recording) -> None:
    answer = diagnosed(slow(usual), slow(simulated), without=IDS - {"wind"})
    assert {f.id for f in answer.found} <= {"wind", "gust"}

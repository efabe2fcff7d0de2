"""The airframe of the flying vehicle against the closed forms that its files promise."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from mavcal.service.simvehicle.errors import ConfigurationError
from mavcal.service.simvehicle.flight.air import Battery, Noise, Wind, density
from mavcal.service.simvehicle.flight.airframe import Airframe
from mavcal.service.simvehicle.flight.control import Mixer
from mavcal.service.simvehicle.flight.frame import GRAVITY, PLUS, X, frame_of, load_frame, rotors_of
from mavcal.service.simvehicle.flight.parameters import FlightParameters, load_parameters
from tests.unit.simvehicle.flights import Flight

REFERENCE_ALTITUDE = 593.0
TICK = 1e-4
HOVER = 1591  # us: the command of 0.551 with which the default frame hovers at its reference altitude


def pulse(command: float) -> int:
    return round(1000.0 + 1000.0 * (0.15 + 0.8 * command))


def lifted(frame: dict | None = None, frame_type: int = X) -> Airframe:
    made = frame_of({"slew_max": 1e9, **(frame or {})})
    body = Airframe(made, rotors_of(made, frame_type), REFERENCE_ALTITUDE - 10.0, 0.0)
    body.on_ground, body.place = False, [0.0, 0.0, -10.0]
    return body


def forces(body: Airframe, pulses: list[int], velocity=(0.0, 0.0, 0.0), wind=(0.0, 0.0, 0.0)) -> np.ndarray:
    body.velocity = list(velocity)
    body.drives = [0.0] * 4
    body.advance(pulses, 12.6, wind, TICK)
    return np.array(body.force)


def test_thrust_follows_the_expo_curve_and_hovers_at_the_stated_throttle() -> None:
    body = lifted({"hoverThrOut": 0.3, "propExpo": 0.5})
    for command in (0.3, 0.6, 1.0):
        share = 0.5 * command + 0.5 * command**2
        got = forces(body, [pulse(command)] * 4)
        np.testing.assert_allclose(got, [0.0, 0.0, -GRAVITY / 0.3 * share], atol=2e-3 * GRAVITY / 0.3)


def test_drag_has_the_coefficients_of_the_real_simulator() -> None:
    """c_1 0.2413 1/s at hover and c_2 0.0336 1/m of SITL's default frame, measured in its flights."""
    body = lifted()
    slow, fast = (-forces(body, [HOVER] * 4, velocity=(v, 0.0, 0.0))[0] for v in (4.0, 8.0))
    c2 = (fast / 8.0 - slow / 4.0) / 4.0
    thrust = -forces(body, [HOVER] * 4)[2]
    c1 = (slow / 4.0 - 4.0 * c2) / math.sqrt(thrust / GRAVITY)
    assert c1 == pytest.approx(0.2413, rel=0.01)
    assert c2 == pytest.approx(0.0336, rel=0.01)


def test_wind_is_the_velocity_of_the_air() -> None:
    body = lifted()
    np.testing.assert_allclose(
        forces(body, [HOVER] * 4, velocity=(5.0, 2.0, 0.0), wind=(5.0, 0.0, 0.0)),
        forces(body, [HOVER] * 4, velocity=(0.0, 2.0, 0.0)),
        atol=1e-12,
    )


def test_a_weak_motor_pushes_less_and_turns_the_vehicle() -> None:
    body = lifted(frame_type=PLUS)
    body.read(FlightParameters({"SIM_ENGINE_FAIL": 4, "SIM_ENGINE_MUL": 0.96}))
    sound = lifted(frame_type=PLUS)
    weak, full = forces(body, [HOVER] * 4)[2], forces(sound, [HOVER] * 4)[2]
    assert weak / full == pytest.approx((3.0 + 0.921) / 4.0, abs=0.002)  # the thrust of d11's label
    assert body.rate[1] < 0.0  # motor 3 is ahead: the nose goes down
    assert abs(sound.rate[1]) < 1e-12


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_inertia_divides_the_torque(axis: int) -> None:
    mix = Mixer(rotors_of(frame_of({}), PLUS), FlightParameters({"FRAME_TYPE": PLUS}))
    command = [0.0, 0.0, 0.0]
    command[axis] = 0.1
    pulses = mix.pulses(*command, throttle=0.4, density_ratio=1.0)
    turned = []
    for factor in (1.0, 1.25):
        moments = [0.023, 0.023, 0.046]
        moments[axis] *= factor
        body = lifted({"moment_inertia": moments}, PLUS)
        forces(body, pulses)
        turned.append(body.rate[axis])
    assert turned[0] > 0.0
    assert turned[0] / turned[1] == pytest.approx(1.25, rel=1e-9)


def test_a_shifted_centre_of_mass_needs_trim() -> None:
    shifted = {f"motor{n}_position": [0.35 * x - 0.012, 0.35 * y, 0.0] for n, (x, y) in enumerate(
        [(0, 1), (0, -1), (1, 0), (-1, 0)], start=1)}  # fmt: skip
    body = lifted(shifted, PLUS)
    forces(body, [HOVER] * 4)
    assert body.rate[1] == pytest.approx(-0.012 * 3.0 * GRAVITY / body._inertia[1] * TICK, rel=0.02)


def test_a_motor_may_follow_slowly_or_at_a_limited_rate() -> None:
    lagging, limited = lifted({"motorTau": 0.05}), lifted({"slew_max": 2.0})
    for body in (lagging, limited):
        for _ in range(500):
            body.advance([2000] * 4, 12.6, (0.0, 0.0, 0.0), TICK)
    assert lagging.drives[0] == pytest.approx(1.0 - math.exp(-1.0), abs=1e-3)
    assert limited.drives[0] == pytest.approx(0.1, abs=1e-9)


def test_a_battery_sags_with_charge_and_current() -> None:
    constant = Battery(frame_of({}), FlightParameters())
    sagging = Battery(frame_of({"battCapacityAh": 2.0, "refBatRes": 0.02}), FlightParameters())
    for battery in (constant, sagging):
        for _ in range(100):
            battery.draw(30.0, 1.0)
    assert constant.voltage == pytest.approx(12.6)
    assert 10.0 < sagging.voltage < 11.8
    assert sagging.used_mah == pytest.approx(30.0 * 100.0 / 3.6)


def test_gusts_have_the_stated_size_and_colour() -> None:
    wind = Wind(FlightParameters({"SIM_WIND_SPD": 4.0, "SIM_WIND_DIR": 90.0, "SIM_WIND_TURB": 0.5}), Noise(1))
    blown = np.array([wind.advance(0.1) for _ in range(40_000)])
    np.testing.assert_allclose(blown.mean(axis=0), [0.0, -4.0, 0.0], atol=0.1)
    np.testing.assert_allclose(blown.std(axis=0), [0.5, 0.5, 0.25], rtol=0.15)
    lag = np.corrcoef(blown[:-50, 0], blown[50:, 0])[0, 1]
    assert lag == pytest.approx(math.exp(-1.0), abs=0.1)  # SIM_WIND_TC 5 s


def test_the_atmosphere_is_the_standard_one() -> None:
    assert density(0.0) == pytest.approx(1.225)
    assert density(1000.0) == pytest.approx(1.1116, abs=2e-4)


@pytest.mark.parametrize(
    ("document", "said"),
    [
        ('{"hoverThrOut": 0}', "must be above zero"),
        ('{"hoverThrust": 0.3}', "no key 'hoverThrust'"),
        ('{"mass": "3"}', "must be a number"),
        ('{"moment_inertia": [1, 2]}', "three numbers"),
        ('{"num_motors": 6}', "only frames of 4"),
        ("[1]", "one object"),
        ("{", "is no JSON"),
    ],
)
def test_a_frame_file_that_cannot_fly_is_refused_with_the_reason(tmp_path: Path, document: str, said: str) -> None:
    file = tmp_path / "frame.json"
    file.write_text(document)
    with pytest.raises(ConfigurationError, match=said):
        load_frame(file)


def test_an_empty_frame_file_is_the_default(tmp_path: Path) -> None:
    file = tmp_path / "frame.json"
    file.write_text("{}")
    assert load_frame(file).inertia == pytest.approx((0.02297, 0.02297, 0.04594), abs=1e-5)


def test_parameters_are_read_from_every_usual_form(tmp_path: Path) -> None:
    file = tmp_path / "x.parm"
    file.write_text("# comment\nSIM_WIND_SPD 3\nFRAME_TYPE,0 # plus\n\nMY_OWN\t1.5\n")
    assert load_parameters(file) == {"SIM_WIND_SPD": 3.0, "FRAME_TYPE": 0.0, "MY_OWN": 1.5}
    file.write_text("SIM_WIND_SPD\n")
    with pytest.raises(ConfigurationError, match=r"line 1: needs NAME VALUE"):
        load_parameters(file)


def test_it_refuses_to_arm_without_a_position(tmp_path: Path) -> None:
    flight = Flight(tmp_path / "a.bin", SIM_GPS1_ENABLE=0.0)
    said: list[str] = []
    flight.vehicle.say = lambda _severity, text: said.append(text)
    flight.wait(6.0)
    assert not flight.vehicle.arm()
    assert said == ["Arm: GPS 1: Bad fix"]
    flight.close()

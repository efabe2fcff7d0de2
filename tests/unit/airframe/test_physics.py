"""The forward model against closed forms, and against the flying vehicle's own physics."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.signal import butter, sosfiltfilt
from scipy.spatial.transform import Rotation

from mavcal.calib.airframe.physics import Kind, slewed
from mavcal.calib.airframe.signals import Grid
from mavcal.calib.recording import Sensor
from mavcal.service.simvehicle.flight.air import density
from mavcal.service.simvehicle.flight.airframe import Airframe as Flying
from mavcal.service.simvehicle.flight.frame import frame_of, rotors_of
from tests.unit.airframe.made import HZ, G, airframe, flight, frame, hover, theta

DT = 1.0 / HZ


def butterworth_of(values: np.ndarray) -> np.ndarray:
    """Without what a grid of 100 Hz does not hold, as commands come from a log."""
    return np.asarray(sosfiltfilt(butter(4, 20.0, fs=HZ, output="sos"), values))


def test_a_hover_carries_its_weight() -> None:
    """(1 - e) c + e c^2 = g / k; nothing turns."""
    k, expo, share = 25.145, 0.65, 0.39
    c = (-(1.0 - expo) + math.sqrt((1.0 - expo) ** 2 + 4.0 * expo * share)) / (2.0 * expo)
    model = airframe(flight(hover(command=c)))
    force, torque = model.predicted(theta(model, k=k, expo=expo))
    np.testing.assert_allclose(force, np.tile([0.0, 0.0, -k * share], (300, 1)), atol=1e-9)
    assert force[0, 2] == pytest.approx(-G, abs=1e-3)
    np.testing.assert_allclose(torque, 0.0, atol=1e-9)


def test_a_turn_is_damped_more_where_air_streams_into_the_rotors() -> None:
    """In 7 m/s of wind turns were damped by a quarter more, and the report doubted the inflow."""
    rate = np.tile([0.5, -0.3, 0.2], (300, 1))

    def damped(climb: float) -> np.ndarray:
        model = airframe(flight(hover(), rate=rate, velocity=np.tile([0.0, 0.0, -climb], (300, 1))))
        plain, with_rise = (
            model.predicted(theta(model, gain_x=1000.0, gain_y=800.0, rise=rise))[1] for rise in (0.0, 2.5e-4)
        )
        return np.asarray((with_rise - plain)[150])

    np.testing.assert_allclose(damped(3.0), [-0.25 * 3.0 * 0.5, 0.2 * 3.0 * 0.3, 0.0], atol=1e-9)
    np.testing.assert_allclose(damped(-3.0), 0.0, atol=1e-12)


def test_products_of_inertia_couple_the_axes_as_a_rigid_body() -> None:
    """I^-1 (moment - w x I w), with I_z = I_x + I_y; the model has the axes' own part of w x I w in `cross`."""
    gain_x, gain_y, share = 280.0, 200.0, {"xy": 0.2, "xz": -0.1, "yz": 0.05}
    diagonal = np.array([1.0 / gain_x, 1.0 / gain_y, 1.0 / gain_x + 1.0 / gain_y])
    whole = np.diag(diagonal)
    for (i, j), value in zip([(0, 1), (0, 2), (1, 2)], share.values(), strict=True):
        whole[i, j] = whole[j, i] = value * diagonal[j]
    c = hover()
    c[:, 0] += 0.02
    w = np.array([1.5, -0.8, 0.6])
    model = airframe(flight(c, rate=np.tile(w, (len(c), 1))))
    plain = theta(model, gain_x=gain_x, gain_y=gain_y)
    apart = plain.copy()
    for pair, value in share.items():
        apart[model.layout.place[f"product_{pair}"]] = value
    without, coupled = (model.predicted(at)[1][150] for at in (plain, apart))
    own = np.cross(w, np.diag(diagonal) @ w)  # the same in both
    expected = np.linalg.solve(whole, diagonal * without - np.cross(w, whole @ w) + own)
    np.testing.assert_allclose(coupled, expected, atol=1e-9)
    assert abs(coupled - without).min() > 0.05


def test_thrust_goes_with_a_power_of_the_voltage() -> None:
    volts = np.linspace(12.6, 10.5, 300)
    model = airframe(flight(hover(), voltage=volts))
    force, _ = model.predicted(theta(model, sag=2.0))
    np.testing.assert_allclose(force[:, 2], -12.5 * (volts / 12.6) ** 2, rtol=1e-9)
    plain = airframe(flight(hover(), voltage=volts), volts=None)
    np.testing.assert_allclose(plain.predicted(theta(plain, sag=2.0))[0][:, 2], -12.5)
    assert model.voltage_span == pytest.approx(12.495 / 10.605 - 1.0, rel=0.01)


@pytest.mark.parametrize("heading_deg", [0.0, 90.0, 200.0])
def test_at_its_final_speed_drag_balances_the_leaning_thrust(heading_deg: float) -> None:
    """Leaning by 15 degrees in a wind: the force is gravity's counterpart, and nothing accelerates."""
    pitch, c1, c2 = math.radians(-15.0), 0.24, 0.0336
    forward = (-c1 + math.sqrt(c1**2 - 4.0 * c2 * G * math.sin(pitch))) / (2.0 * c2)  # c1 u + c2 u^2 = g sin 15
    speed = forward / math.cos(pitch)
    turn = Rotation.from_euler("ZYX", [math.radians(heading_deg), pitch, 0.0])
    wind = np.array([2.0, -1.0, 0.0])
    moving = Rotation.from_euler("Z", math.radians(heading_deg)).apply([speed, 0.0, 0.0]) + wind
    n = 50
    one = flight(
        hover(n / HZ), velocity=np.tile(moving, (n, 1)), q=np.tile(turn.as_quat(scalar_first=True), (n, 1))
    )  # fmt: skip
    model = airframe(one, kind=Kind(drag_by_rotor=False))
    down = speed * math.sin(pitch)
    k = (G * math.cos(pitch) + c2 * down**2) / 0.5
    at = theta(model, k=k, c1=c1, c2=c2, wind_north=2.0, wind_east=-1.0)
    np.testing.assert_allclose(model.air_velocity(at)[0], [forward, 0.0, down], atol=1e-9)
    force, _ = model.predicted(at)
    np.testing.assert_allclose(turn.apply(force), np.tile([0.0, 0.0, -G], (n, 1)), atol=1e-9)


def test_drag_points_against_the_air_on_every_axis() -> None:
    velocity = np.array([[3.0, -2.0, 1.0], [-3.0, 2.0, -1.0]] * 5)
    model = airframe(flight(hover(0.1), velocity=velocity), kind=Kind(drag_by_rotor=False))
    force, _ = model.predicted(theta(model, c1=0.3, cz=0.2, c2=0.05))
    known = -np.array([0.3, 0.3, 0.2]) * velocity - 0.05 * velocity * np.abs(velocity)
    np.testing.assert_allclose(force - [0.0, 0.0, -12.5], known, atol=1e-12)
    lifted, _ = model.predicted(theta(model, ch=0.01))
    np.testing.assert_allclose(lifted[:, 2] + 12.5, -0.01 * 13.0)


def test_drag_of_rotors_goes_with_their_speed() -> None:
    """c1 is stated at hover: at four times the thrust the rotors turn twice as fast."""
    for command, factor in ((G / 25.0, 1.0), (4.0 * G / 25.0, 2.0), (0.25 * G / 25.0, 0.5)):
        model = airframe(flight(hover(0.1, command), velocity=np.tile([2.0, 0.0, 0.0], (10, 1))))
        force, _ = model.predicted(theta(model, c1=0.3))
        np.testing.assert_allclose(force[:, 0], -0.6 * factor)


MOTORS = {1: (1, -1, -1), 2: (-1, 1, -1), 3: (-1, -1, 1), 4: (1, 1, 1)}
"""Roll, pitch and yaw of a quad X by motor: the vehicle leans towards the weak one, and turns as it does.

The propeller of 1 and 2 turns counter-clockwise, so that its reaction is clockwise, +z; a weak one leaves -z.
"""


@pytest.mark.parametrize("motor", sorted(MOTORS))
@pytest.mark.parametrize("form", ["weak", "pulse"])
def test_a_weak_motor_turns_the_vehicle_towards_itself(motor: int, form: str) -> None:
    model = airframe(flight(hover()))
    force, torque = model.predicted(theta(model, **{f"{form}_{motor}": -0.08}))
    assert tuple(np.sign(torque[5]).astype(int)) == MOTORS[motor]
    lost = 0.08 * 0.5 + (0.08 * 0.1875 if form == "pulse" else 0.0)
    assert force[5, 2] == pytest.approx(-12.5 + 25.0 / 4.0 * lost)
    assert abs(torque[5, 0]) == pytest.approx(abs(torque[5, 1]))


def test_a_centre_of_mass_ahead_and_to_the_right_lets_the_nose_and_the_right_side_sink() -> None:
    model = airframe(flight(hover(), frame("quad-plus")))
    _, ahead = model.predicted(theta(model, cg_x=0.03))
    _, right = model.predicted(theta(model, cg_y=0.03))
    assert ahead[3, 1] < 0.0 == pytest.approx(ahead[3, 0])
    assert right[3, 0] > 0.0 == pytest.approx(right[3, 1])
    # by angular momentum: thrust over mass times the offset, by inertia over mass
    assert -ahead[3, 1] == pytest.approx(280.0 * 0.5 * 0.03)
    double = airframe(flight(hover(command=0.25), frame("quad-plus")))
    assert double.predicted(theta(double, cg_x=0.03))[1][3, 1] == pytest.approx(0.5 * ahead[3, 1])


@pytest.mark.parametrize(("by_rotor", "grows"), [(True, math.sqrt(1.5)), (False, 1.0)])
def test_torque_by_air_velocity_goes_with_the_rotors_speed(by_rotor: bool, grows: float) -> None:
    """A trim that stayed in a climb would pass for one that goes with the thrust, and blame a motor."""

    def turned(thrust: float) -> float:
        rows = flight(np.full((100, 4), thrust * G / 25.0), velocity=np.tile([0.0, 3.0, 0.0], (100, 1)))
        plain = airframe(rows, kind=Kind(drag_by_rotor=by_rotor))
        found = plain.predicted(theta(plain, expo=0.0, k=25.0, tau=0.0, delay=0.0, flap_x=0.2))[1]
        return float(found[50, 0])

    assert turned(1.0) == pytest.approx(-0.6, rel=1e-3)
    assert turned(1.5) / turned(1.0) == pytest.approx(grows, rel=1e-3)


def test_turns_are_damped_and_a_trim_stays() -> None:
    rates = np.tile([0.5, -1.0, 2.0], (100, 1))
    model = airframe(flight(hover(1.0), rate=rates))
    _, torque = model.predicted(theta(model, damping_x=2.0, damping_y=2.0, damping_z=1.0, torque_y=3.0))
    np.testing.assert_allclose(torque, np.tile([-1.0, 5.0, -2.0], (100, 1)))


def test_a_unit_beside_the_centre_feels_turns() -> None:
    """At r: rate x (rate x r) towards the axis, and the angular acceleration times r."""
    t = np.arange(200) * DT
    rates = np.column_stack([np.zeros(200), np.zeros(200), 2.0 + 0.5 * t])
    model = airframe(flight(hover(2.0), rate=rates))
    force, _ = model.predicted(theta(model, lever_x=0.1))
    np.testing.assert_allclose(force[5:-5, 0], -0.1 * rates[5:-5, 2] ** 2, atol=1e-9)
    np.testing.assert_allclose(force[5:-5, 1], 0.1 * 0.5, atol=1e-9)


def test_a_delay_may_be_a_part_of_a_step() -> None:
    told = np.tile((0.5 + 0.002 * np.arange(200))[:, None], (1, 4))
    model = airframe(flight(told))
    for delay in (0.0, 0.004, 0.01, 0.025):
        force, _ = model.predicted(theta(model, delay=delay))
        np.testing.assert_allclose(force[20:180, 2], -25.0 * (told[20:180, 0] - 0.2 * delay), rtol=1e-3)


def test_a_falling_command_may_take_longer() -> None:
    t = np.arange(400) * DT
    told = butterworth_of(0.5 + 0.2 * np.sign(np.sin(2.0 * np.pi * 0.8 * t)) * (t > 0.3))
    tau, fall, fine = 0.06, 0.024, 50
    known, x = [], float(told[0])
    for row in range(len(told)):
        known.append(x)
        for part in range(fine):
            now = np.interp(t[row] + DT * part / fine, t, told)
            x += (now - x) * DT / fine / (tau + fall if now < x else tau)
    model = airframe(flight(np.tile(told[:, None], (1, 4))))
    found, plain = (-model.predicted(theta(model, tau=tau, fall=f))[0][:, 2] / 25.0 for f in (fall, 0.0))
    np.testing.assert_allclose(found, known, atol=0.01)
    assert np.abs(plain - known).max() > 0.03


def test_a_limited_command_changes_no_faster_and_arrives() -> None:
    c = np.concatenate([np.zeros(10), np.ones(50), np.full(50, 0.2)])[:, None] * [1.0, 0.1]
    out = slewed(c, np.full(110, 0.05))
    assert np.abs(np.diff(out, axis=0)).max() == pytest.approx(0.05)
    np.testing.assert_allclose(out[29], [1.0, 0.1])
    np.testing.assert_allclose(out[28], [0.95, 0.1])
    np.testing.assert_allclose(slewed(c, np.full(110, 2.0)), c, atol=1e-12)
    model = airframe(flight(np.tile(c[:, :1], (1, 4))), slew=5.0)
    force, _ = model.predicted(theta(model))
    np.testing.assert_allclose(force[:, 2], -25.0 * out[:, 0], atol=1e-6)


def test_a_limit_may_change_with_the_steps_of_a_log() -> None:
    t = np.array([0.0, 0.1, 0.15, 0.4, 0.5])
    c = np.array([0.0, 1.0, 1.0, 1.0, 1.0])[:, None]
    out = slewed(c, 2.0 * np.diff(t, prepend=0.0))
    np.testing.assert_allclose(out[:, 0], [0.0, 0.2, 0.3, 0.8, 1.0])


def test_predictions_go_through_the_filter_of_the_sensors() -> None:
    c = hover(2.0)
    c[100:] += 0.1
    sharp, soft = (airframe(flight(c, cutoff_hz=corner)) for corner in ({}, {Sensor.ACCEL: 20.0, Sensor.GYRO: 10.0}))
    at, grid = theta(sharp, weak_1=-0.1), Grid(len(c), HZ)
    for k, corner in enumerate((20.0, 10.0)):
        known = grid.through(sharp.predicted(at)[k], grid.butterworth(corner))
        np.testing.assert_allclose(soft.predicted(at)[k], known, atol=1e-9)


def test_it_says_what_the_simulated_vehicle_does() -> None:
    """Forces and torques of random commands and speeds: two sources for the formulas of SITL's frame."""
    rng, rows = np.random.default_rng(7), 200
    made = frame_of({"slew_max": 1e12})
    body = Flying(made, rotors_of(made, 1), 593.0, 0.0)
    pulses = rng.integers(1400, 1750, (rows, 4))
    velocity = rng.uniform(-8.0, 8.0, (rows, 3)) * [1.0, 1.0, 0.0]
    forces, turns, dt = [], [], 1e-6
    for told, v in zip(pulses.tolist(), velocity, strict=True):
        body.on_ground, body.place, body.velocity, body.rate = False, [0.0, 0.0, 0.0], v.tolist(), [0.0, 0.0, 0.0]
        body.q = (1.0, 0.0, 0.0, 0.0)
        body.place[2] = -1e-3
        body.advance(told, 12.6, (0.0, 0.0, 0.0), dt)
        forces.append(body.force)
        turns.append(np.array(body.rate) / dt)
    c = (pulses - 1150.0) / 800.0
    rho, arm, lever, mass, (ix, iy, iz) = density(593.0), 0.35, math.sqrt(0.5), 3.0, made.inertia
    c1 = 0.2 * 4 * math.sqrt(rho * 0.385 / 4) * math.sqrt(mass * G / 4) / mass
    model = airframe(flight(c, velocity=velocity), kind=Kind(drag_by_rotor=True, yaw_by_command=True))
    at = theta(
        model, k=G / 0.39, expo=0.65, c1=c1, c2=0.03361, gain_x=mass * arm * lever * G / 0.39 / ix,
        gain_y=mass * arm * lever * G / 0.39 / iy, gain_z=0.05 * arm * mass * G / 0.39 / iz,
    )  # fmt: skip
    force, torque = model.predicted(at)
    np.testing.assert_allclose(force, forces, atol=2e-3)
    scale = np.abs(turns).max(axis=0)
    np.testing.assert_allclose(torque / scale, turns / scale, atol=2e-3)


@pytest.mark.parametrize("turns", [True, False])
def test_drag_at_the_centre_of_the_vehicle_turns_nothing(turns: bool) -> None:
    """ArduPilot's simulator of 2023 subtracts the drag of a rotor after it has taken its torque."""
    c = 0.5 + 0.1 * np.array([1.0, -1.0, -1.0, 1.0]) * np.ones((400, 1))
    model = airframe(flight(c, velocity=np.tile([4.0, -2.0, 1.0], (400, 1))), kind=Kind(drag_turns=turns))
    usual = {"k": 25.0, "gain_x": 200.0, "gain_y": 200.0, "gain_z": 8.0}
    with_drag, without = (model.predicted(theta(model, **usual, c1=d, cz=d)) for d in (0.4, 0.0))
    assert np.abs(with_drag[0] - without[0]).max() > 1.0
    assert bool(np.abs(with_drag[1] - without[1]).max() > 0.1) is turns
    assert Kind(drag_turns=turns).rotors_damp is turns

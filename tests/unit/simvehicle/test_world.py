from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from mavcal.service.simvehicle.config import VehicleConfig, load_config
from mavcal.service.simvehicle.errors import ConfigurationError
from mavcal.service.simvehicle.parameters import load_table
from mavcal.service.simvehicle.truth import draw_truth
from mavcal.service.simvehicle.world import RandomWalk, SimWorld, Thermal


def test_a_seed_gives_the_same_truth_again_and_another_gives_another() -> None:
    a, b, c = (draw_truth(VehicleConfig(seed=s)) for s in (4, 4, 5))
    assert (a.accels[0].matrix == b.accels[0].matrix).all()
    assert not np.allclose(a.accels[0].offset, c.accels[0].offset)


def test_truth_is_within_its_documented_ranges() -> None:
    for seed in range(20):
        truth = draw_truth(VehicleConfig(seed=seed))
        for accel, gyro in zip(truth.accels, truth.gyros, strict=True):
            assert (np.abs(accel.offset) >= 0.1).all()
            assert (np.abs(accel.offset) <= 0.4).all()
            assert (np.abs(np.diag(accel.matrix) - 1) >= 0.008).all()
            assert (np.abs(np.diag(accel.matrix) - 1) <= 0.025).all()
            assert (np.abs(gyro.offset) >= 5e-3).all()
            assert (np.abs(gyro.offset) <= 30e-3).all()
            assert (np.abs(accel.polynomial[:, 0]) >= 4e-3).all()
        for mag in truth.mags:
            correction = np.linalg.inv(mag.matrix)
            assert correction == pytest.approx(correction.T)
            assert (np.abs(np.diag(correction) - 1) >= 0.03).all()
            assert (np.abs(mag.offset) <= 12.0).all()


def test_raw_is_matrix_times_true_plus_offset_plus_polynomial() -> None:
    config = load_config({"accel_noise": 0.0, "gyro_noise": 0.0, "temperature": 50.0, "seed": 7})
    world = SimWorld(config)
    state = world.state(np.array([1.0]))
    truth, d = world.truth.accels[0], 15.0
    p = truth.polynomial @ [d, d * d, d**3]
    expected = truth.matrix @ [0, 0, -9.80665] + truth.offset + p
    assert world.accel(0, state)[0] == pytest.approx(expected)
    gyro = world.truth.gyros[0]
    assert world.gyro(0, state)[0] == pytest.approx(gyro.offset + gyro.polynomial @ [d, d * d, d**3])


def test_noise_has_the_configured_size() -> None:
    world = SimWorld(load_config({"accel_noise": 0.05, "thermal": False}))
    state = world.state(np.linspace(0, 1, 20000))
    assert world.accel(1, state).std(axis=0) == pytest.approx([0.05] * 3, rel=0.03)


def test_thermal_off_leaves_the_sensors_alone() -> None:
    cold, hot = (SimWorld(load_config({"thermal": False, "accel_noise": 0.0, "temperature": t})) for t in (0.0, 60.0))
    a, b = (w.accel(0, w.state(np.zeros(1))) for w in (cold, hot))
    assert a == pytest.approx(b)


def test_motors_disturb_the_magnetometers_in_proportion_to_the_current() -> None:
    world = SimWorld(load_config({"mag_noise": 0.0}))
    field = np.array([[10.0, 0.0, 0.0]])
    still = world.mag(0, field, np.zeros(1))
    world.current.go(0.0, 20.0)
    assert world.mag(0, field, np.ones(1)) - still == pytest.approx(20.0 * world.truth.mags[0].motor[None])


def test_a_magnetometer_sees_the_field_in_its_own_frame() -> None:
    clean = {"offset": [0, 0, 0], "matrix": np.eye(3).tolist()}
    world = SimWorld(load_config({"mag_noise": 0.0, "mag_orientations": [0, 2, 0], "truth": {"mags": clean}}))
    field = np.array([[10.0, 0.0, 5.0]])
    # Mounted with its x axis to the right: forward is along its −y.
    assert world.mag(1, field, np.zeros(1))[0] == pytest.approx([0.0, -10.0, 5.0])


def test_a_ramp_moves_in_a_straight_line() -> None:
    world = SimWorld(VehicleConfig())
    world.throttle.go(1.0, 0.5, 2.0)
    assert world.throttle.at(np.array([0.5, 1.0, 2.0, 3.0, 9.0])) == pytest.approx([0.0, 0.0, 0.25, 0.5, 0.5])


def test_a_warm_up_is_an_exponential_with_an_offset_for_each_imu() -> None:
    thermal = Thermal(20.0, np.array([0.0, 1.2]))
    thermal.warm_up(10.0, 20.0, 60.0, 30.0)
    t = np.array([10.0, 40.0, 1e4])
    expected = [20.0, 60 - 40 / np.e, 60.0]
    assert thermal.imu(0, t) == pytest.approx(expected)
    assert thermal.imu(1, t) == pytest.approx(np.array(expected) + 1.2)


def test_a_lagging_imu_solves_its_differential_equation() -> None:
    thermal = Thermal(20.0, np.zeros(1), lag_s=5.0)
    thermal.warm_up(0.0, 20.0, 60.0, 30.0)
    t = np.linspace(0.0, 100.0, 10001)
    lagged, board = thermal.imu(0, t), thermal.board(t)
    assert np.gradient(lagged, t)[1:-1] == pytest.approx(((board - lagged) / 5.0)[1:-1], abs=1e-3)


def test_the_world_goes_on_through_a_reboot() -> None:
    world = SimWorld(VehicleConfig(accel_noise=0.0))
    world.motion.tumble(0.0)
    world.thermal.warm_up(0.0, 20.0, 60.0, 30.0)
    before = world.accel(0, world.state(np.array([20.0])))
    world.restart(15.0)
    assert world.accel(0, world.state(np.array([5.0]))) == pytest.approx(before)


@pytest.mark.parametrize(
    ("entry", "reason"),
    [
        ({"colour": 1}, "unknown configuration colour"),
        ({"imu_count": 4}, "imu_count must be"),
        ({"seed": "x"}, "seed"),
        ({"thermal": 1}, "must be true or false"),
        ({"autopilot": "betaflight"}, "autopilot"),
        ({"truth": {"accels": {"offset": [1, 2]}}}, "accels offset"),
        ({"truth": {"barometers": {}}}, "unknown kind"),
        ({"truth": {"mags": [None, None, None]}}, "the vehicle has 2"),
    ],
)
def test_a_wrong_configuration_is_named(entry: dict[str, object], reason: str) -> None:
    with pytest.raises(ConfigurationError, match=reason):
        SimWorld(load_config(entry))


def test_a_configuration_may_be_text_or_a_file(tmp_path: Path) -> None:
    path = tmp_path / "c.json"
    path.write_text(json.dumps({"imu_count": 2}))
    assert load_config(str(path)).imu_count == 2
    assert load_config('{"imu_count": 1}').imu_count == 1
    with pytest.raises(ConfigurationError, match="no JSON"):
        load_config("{broken")
    with pytest.raises(ConfigurationError, match="cannot be read"):
        load_config(str(tmp_path / "absent.json"))


def test_a_parameter_file_keeps_its_order_and_names_its_broken_line(tmp_path: Path) -> None:
    path = tmp_path / "p.csv"
    path.write_text("name,value,type\nB,1.5,9\n# comment\nA,-1,6\n")
    assert [(p.name, p.value, int(p.kind)) for p in load_table(str(path))] == [("B", 1.5, 9), ("A", -1, 6)]
    path.write_text("B,1.5,9\nA,x,6\n")
    with pytest.raises(ConfigurationError, match="line 2"):
        load_table(str(path))


def test_it_grows_with_the_root_of_time():
    ends = np.array([RandomWalk(np.random.default_rng(seed))(np.array([100.0])) for seed in range(60)])
    assert np.sqrt(np.mean(ends**2)) == pytest.approx(10.0, rel=0.2)


def test_it_is_the_same_however_it_is_read_and_starts_at_zero():
    wander, t = RandomWalk(np.random.default_rng(1)), np.linspace(0.0, 50.0, 501)
    together = wander(t)
    np.testing.assert_array_equal(together, np.vstack([wander(part) for part in np.array_split(t, 7)]))
    assert not together[0].any()


def test_a_restart_of_the_clock_does_not_move_it():
    wander = RandomWalk(np.random.default_rng(2))
    before = wander(np.array([40.0]))
    wander.restart(40.0)
    np.testing.assert_array_equal(wander(np.array([0.0])), before)

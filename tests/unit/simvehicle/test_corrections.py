from __future__ import annotations

import numpy as np
import pytest

from mavcal.service.simvehicle.corrections import (
    ArduPilotThermal,
    ardupilot_accel,
    ardupilot_compass,
    ardupilot_gyro,
    px4_accel,
    px4_gyro,
    px4_mag,
    px4_thermal,
    truncated,
)

YAW_90 = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


def row(*values: float) -> np.ndarray:
    return np.array([values], dtype=float)


def test_truncation_is_toward_zero_with_a_zero_bin_twice_as_wide() -> None:
    values = np.array([1.999, 0.999, 0.4, -0.4, -0.999, -1.0, -1.999, 2.0])
    assert truncated(values, 1.0).tolist() == [1, 0, 0, 0, 0, -1, -1, 2]


def test_truncation_of_gravity_in_milli_g() -> None:
    assert truncated(np.array([-9.81746]), 1000.0, 9.80665).tolist() == [-1001]
    assert truncated(np.array([-9.80]), 1000.0, 9.80665).tolist() == [-999]


def test_truncation_saturates_and_takes_nan_as_zero() -> None:
    assert truncated(np.array([1e9, -1e9, np.nan]), 1.0).tolist() == [32767, -32768, 0]


def test_ardupilot_accel_subtracts_offset_then_scales() -> None:
    corrected = ardupilot_accel(row(0.31, -0.22, -9.5), np.array([0.31, -0.22, 0.17]), np.array([1.021, 0.984, 1.013]))
    assert corrected == pytest.approx(row(0.0, 0.0, 1.013 * -9.67))


def test_ardupilot_thermal_term_goes_before_the_scale_and_the_board_rotation_last() -> None:
    corrected = ardupilot_accel(
        row(1.0, 2.0, 3.0), np.zeros(3), np.array([2.0, 1.0, 1.0]), np.array([[0.5, 0.0, 0.0]]), YAW_90
    )
    assert corrected == pytest.approx(row(-2.0, 1.0, 3.0))


def test_ardupilot_gyro_has_no_scale() -> None:
    corrected = ardupilot_gyro(row(0.1, 0.0, 0.0), np.array([0.03, 0.0, 0.0]), np.array([[0.02, 0.0, 0.0]]))
    assert corrected == pytest.approx(row(0.05, 0.0, 0.0))


def test_ardupilot_polynomial_is_about_35_degrees_with_coefficients_in_millionths() -> None:
    thermal = ArduPilotThermal(np.array([[8000.0] * 3, [150.0] * 3, [2.0] * 3]), 0.0, 70.0)
    expected = 1e-6 * (8000 * 10 + 150 * 100 + 2 * 1000)
    assert thermal.polynomial(np.array([45.0]))[0] == pytest.approx([expected] * 3)
    assert thermal.polynomial(np.array([35.0]))[0] == pytest.approx([0.0] * 3)


def test_ardupilot_unknown_calibration_temperature_is_clamped_to_tmin() -> None:
    thermal = ArduPilotThermal(np.array([[1000.0] * 3, [0.0] * 3, [0.0] * 3]), 10.0, 70.0)
    # P(45) − P(10): 10·1e-3 + 25·1e-3
    assert thermal.correction(np.array([45.0]), -300.0)[0] == pytest.approx([0.035] * 3)
    assert thermal.correction(np.array([90.0]), 70.0)[0] == pytest.approx([0.0] * 3)


def test_ardupilot_compass_adds_offsets_and_the_motor_term_comes_last() -> None:
    corrected = ardupilot_compass(
        row(100.0, 0.0, 0.0),
        np.array([20.0, 10.0, 0.0]),
        np.array([1.1, 1.0, 1.0]),
        np.array([0.05, 0.0, 0.0]),
        1.0,
        row(5.0, 0.0, 0.0),
    )
    assert corrected == pytest.approx(row(1.1 * 120 + 0.05 * 10 + 5, 0.05 * 120 + 10, 0.0))


@pytest.mark.parametrize(("scale", "factor"), [(1.2, 1.2), (1.5, 1.5), (1.51, 1.0), (0.66, 1.0), (0.0, 1.0)])
def test_ardupilot_compass_scale_outside_its_window_is_ignored(scale: float, factor: float) -> None:
    corrected = ardupilot_compass(row(100.0, 0.0, 0.0), np.zeros(3), np.ones(3), np.zeros(3), scale)
    assert corrected == pytest.approx(row(100.0 * factor, 0.0, 0.0))


def test_ardupilot_all_zero_diagonal_switches_the_matrix_off() -> None:
    corrected = ardupilot_compass(row(1.0, 2.0, 3.0), np.zeros(3), np.zeros(3), np.full(3, 0.5), 0.0)
    assert corrected == pytest.approx(row(1.0, 2.0, 3.0))


def test_px4_thermal_has_a_constant_and_clamps() -> None:
    coefficients = np.array([[0.1] * 3, [0.01] * 3, [0.0] * 3, [1e-6] * 3])
    at_35 = px4_thermal(coefficients, 25.0, 0.0, 60.0, np.array([35.0]))[0]
    assert at_35 == pytest.approx([0.1 + 0.1 + 1e-3] * 3)
    beyond = px4_thermal(coefficients, 25.0, 0.0, 60.0, np.array([100.0]))[0]
    assert beyond == pytest.approx([0.1 + 0.35 + 1e-6 * 35**3] * 3)


def test_px4_accel_gyro_and_mag_subtract_then_scale_then_rotate() -> None:
    off, scale, tc = np.array([0.1, 0.0, 0.0]), np.array([2.0, 1.0, 1.0]), row(0.2, 0.0, 0.0)
    assert px4_accel(row(1.0, 0.0, 0.0), off, scale, tc, YAW_90) == pytest.approx(row(0.0, 1.4, 0.0))
    assert px4_gyro(row(1.0, 0.0, 0.0), off, tc, YAW_90) == pytest.approx(row(0.0, 0.7, 0.0))
    mag = px4_mag(row(0.3, 0.1, 0.0), off, np.ones(3), np.array([0.5, 0.0, 0.0]), row(0.2, 0.0, 0.0), np.eye(3))
    # m + p·COMP − OFF = (0.4, 0.1, 0); S adds half of the other axis.
    assert mag == pytest.approx(row(0.45, 0.3, 0.0))

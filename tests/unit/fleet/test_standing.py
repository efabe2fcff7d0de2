from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.fit import FitBuilder
from mavcal.calib.fleet.record import ObservationSource, SensorRecord, bias_of
from mavcal.calib.fleet.standing import (
    LEAST,
    FailedCheck,
    LastPreflight,
    ReasonCode,
    UnitStanding,
    fleet_standing,
    limit_of,
    oddness,
)
from mavcal.calib.fleet.trend import DAY_S, Quantity
from mavcal.calib.preflight import limits
from mavcal.calib.preflight.check import CheckId, Verdict
from mavcal.calib.recording import Sensor
from mavcal.calib.report import from_json, to_json
from mavcal.calib.triad import TriadModel
from tests.unit.fleet.odd_groups import alarms, limit

SPI = 0x340008 | 2
"""An ICM-42688 on bus 1 of an ArduPilot."""


def record(unit: str = "a", sensor: Sensor = Sensor.GYRO, day: float = 0.0, **changes: Any) -> SensorRecord:
    plain = SensorRecord(unit, "ardupilot", sensor, 0, SPI, day * DAY_S, ObservationSource.JOB, f"job{day}", "gyro",
                         applied=True, proved=True, bias=(0.0, 0.0, 0.0), sd=(1e-4, 1e-4, 1e-4),
                         temperature=25.0)  # fmt: skip
    return dataclasses.replace(plain, **changes)


def standing(*records: SensorRecord, day: float = 1.0, preflight: LastPreflight | None = None) -> UnitStanding:
    preflights = {} if preflight is None else {"a": preflight}
    return fleet_standing({"a": records}, preflights, day * DAY_S)["a"]


def codes(found: UnitStanding) -> list[ReasonCode]:
    return [reason.code for reason in found.reasons]


def test_a_fresh_calibration_needs_none() -> None:
    found = standing(record())
    assert found.reasons == ()
    assert found.sensors[0].calibrated_at == 0.0
    assert found.sensors[0].name == "gyroscope 1 (ICM-42688)"


def test_a_unit_of_which_nothing_is_known_was_never_calibrated() -> None:
    assert codes(standing()) == [ReasonCode.NEVER]


def test_a_sensor_without_a_calibration_beside_one_with_it_is_named() -> None:
    found = standing(record(), record(sensor=Sensor.ACCEL, applied=False))
    (reason,) = found.reasons
    assert (reason.code, reason.sensor, reason.instance) == (ReasonCode.NEVER, Sensor.ACCEL, 0)
    assert "accelerometer 1" in reason.text


def test_age_is_judged_by_the_limit_of_the_preflight() -> None:
    limit = limits.CALIBRATION_AGE.value
    assert standing(record(), day=limit - 1.0).reasons == ()
    (reason,) = standing(record(), day=limit + 1.0).reasons
    assert reason.code == ReasonCode.AGE
    assert reason.text == "The calibration of gyroscope 1 (ICM-42688) is 366 d old, limit 365 d."


def drifting(unit: str = "a", **changes: Any) -> list[SensorRecord]:
    rng = np.random.default_rng(2)
    rate = np.radians(0.5) / 200.0
    return [
        record(unit, day=50.0 * i, bias=(50.0 * i * rate + 1e-4 * rng.standard_normal(), 0.0, 0.0), **changes)
        for i in range(6)
    ]


def test_a_drift_that_may_have_left_its_limit_is_a_reason_from_its_earliest_date_on() -> None:
    assert standing(*drifting(), day=251.0).reasons == ()
    (reason,) = standing(*drifting(), day=250.0 + 200.0).reasons
    assert reason.code == ReasonCode.DRIFT
    assert reason.text.startswith("The bias of gyroscope 1 (ICM-42688) may have left its limit of 0.5 deg/s: by its")


def test_a_vehicle_that_calibrates_its_gyroscopes_by_itself_leaves_no_limit() -> None:
    found = standing(*drifting(by_itself=True), day=450.0)
    assert found.reasons == ()
    trend = found.sensors[0].trend
    assert trend.leaving is None
    assert any(o.quantity == Quantity.LEAVING and "by itself" in o.why for o in trend.open)


def test_a_calibration_that_no_stream_proved_is_in_no_trend() -> None:
    found = standing(*drifting(proved=False), day=251.0)
    assert found.sensors[0].trend.n == 0
    assert found.sensors[0].calibrated_at == 250.0 * DAY_S


def failed(check: CheckId, day: float, verdict: Verdict = Verdict.FAIL) -> LastPreflight:
    return LastPreflight(day * DAY_S, verdict, (FailedCheck(check, verdict, "it is off."),))


def test_a_failed_preflight_is_a_reason_until_its_sensor_is_calibrated() -> None:
    before = standing(record(), preflight=failed(CheckId.GYRO_REST, 0.5))
    assert [r.text for r in before.reasons] == ["The preflight of 1970-01-01 failed gyro_rest: it is off."]
    assert standing(record(), record(day=0.7), preflight=failed(CheckId.GYRO_REST, 0.5)).reasons == ()
    other = standing(record(), record(sensor=Sensor.ACCEL, day=0.7), preflight=failed(CheckId.GYRO_REST, 0.5))
    assert codes(other) == [ReasonCode.PREFLIGHT]


@pytest.mark.parametrize("check", [CheckId.VIBRATION, CheckId.GYRO_NOISE, CheckId.ARMING_CHECKS])
def test_what_no_calibration_mends_is_none(check: CheckId) -> None:
    assert standing(record(), preflight=failed(check, 0.5)).reasons == ()


def test_a_warning_is_none() -> None:
    assert standing(record(), preflight=failed(CheckId.GYRO_REST, 0.5, Verdict.WARN)).reasons == ()


def test_a_swapped_board_begins_a_history_of_its_own() -> None:
    old = drifting()
    new = record(day=300.0, device_id=SPI + 0x100, applied=False, source=ObservationSource.PREFLIGHT)
    found = standing(*old, new, day=301.0)
    assert len(found.sensors) == 1
    assert found.sensors[0].trend.n == 1
    assert codes(found) == [ReasonCode.NEVER]


def test_sensors_of_a_type_are_compared_over_the_fleet() -> None:
    rng = np.random.default_rng(4)
    names = [f"u{i}" for i in range(12)]
    records = {u: [record(u, bias=tuple(0.01 * rng.standard_normal(3)))] for u in names}
    records["u7"] = [record("u7", bias=(0.5, 0.0, 0.0))]
    records["can"] = [record("can", bias=(9.0, 0.0, 0.0), device_id=0x020003)]
    found = fleet_standing(records, {}, DAY_S)
    odd = {u for u, one in found.items() if one.sensors[0].oddness is not None and one.sensors[0].oddness.odd}
    assert odd == {"u7"}
    assert found["can"].sensors[0].oddness is None  # ArduPilot does not say what is behind a node


def test_a_record_survives_json() -> None:
    one = record()
    assert from_json(to_json(one), SensorRecord) == one


def fit(**changes: Any) -> Any:
    covariance = np.zeros((12, 12))
    covariance[:3, :3] = np.eye(3) * 1e-6
    builder = FitBuilder("gyro-rest", Sensor.GYRO, 0, "rad/s", 100, relative=changes.pop("relative", False))
    return builder.fitted(
        TriadModel(offset=np.array([1.0, 2.0, 3.0])), changes.pop("covariance", covariance), message="", n_used=100,
        residual_rms=0.0, condition_number=1.0, **changes)  # fmt: skip


def test_only_an_absolute_bias_of_every_axis_is_one() -> None:
    assert bias_of(fit()) == ((1.0, 2.0, 3.0), (1e-3, 1e-3, 1e-3))
    assert bias_of(fit(relative=True)) is None
    assert bias_of(fit(undetermined={"offset_x": "turn it"})) is None
    assert bias_of(fit(covariance=np.zeros((12, 12)))) is None


def healthy(n: int, seed: int = 1) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal((n, 3))


def test_one_that_is_off_is_named_with_its_axis() -> None:
    values = healthy(30)
    values[4, 2] += 12.0
    found = oddness(values.tolist(), [0.0] * 30)
    assert [i for i, one in enumerate(found) if one is not None and one.odd] == [4]
    assert found[4] is not None
    assert (found[4].axis, found[4].group, found[4].limit) == (2, 30, limit_of(30))


def test_a_third_of_the_group_hides_none_of_its_own() -> None:
    values = healthy(30)
    values[:9, 0] += 40.0
    found = oddness(values.tolist(), [0.0] * 30)
    assert [i for i, one in enumerate(found) if one is not None and one.odd] == list(range(9))


def test_few_sensors_say_nothing_of_each_other() -> None:
    assert oddness(healthy(LEAST - 1).tolist(), [0.0] * (LEAST - 1)) == (None,) * (LEAST - 1)
    assert oddness([], []) == ()


def test_differences_below_the_measurement_are_none() -> None:
    values = np.zeros((12, 3))
    values[0, 0] = 0.01
    assert not any(one is not None and one.odd for one in oddness(values.tolist(), [0.01] * 12))
    exact = oddness(values.tolist(), [0.0] * 12)
    assert exact[0] is not None
    assert exact[0].odd
    assert np.isfinite(exact[0].distance)


def test_what_is_not_finite_is_refused() -> None:
    values = healthy(8)
    values[3, 1] = np.nan
    with pytest.raises(InvalidInputError):
        oddness(values.tolist(), [0.0] * 8)


@pytest.mark.parametrize("n", [6, 10, 21, 101])
def test_the_table_of_limits_is_what_healthy_groups_say(n: int) -> None:
    assert limit_of(n) == pytest.approx(limit(n, 8000, seed=7), rel=0.12)


def test_a_size_between_two_has_the_limit_of_the_smaller_and_a_very_large_group_a_larger_one() -> None:
    assert limit_of(24) == limit_of(21)
    assert limit_of(100_000) > limit_of(1001)


@pytest.mark.parametrize("n", [7, 23, 60])
def test_healthy_groups_are_called_odd_as_rarely_as_stated(n: int) -> None:
    wrong, _ = alarms(n, 600, seed=5)
    assert wrong <= 6 + 3.0 * np.sqrt(6.0)


@given(st.integers(LEAST, 20), st.integers(0, 1000), st.floats(0.1, 10.0), st.floats(-5.0, 5.0))
def test_unit_and_origin_do_not_matter(n: int, seed: int, scale: float, shift: float) -> None:
    values = healthy(n, seed)
    one = oddness(values.tolist(), [0.0] * n)
    other = oddness((scale * values + shift).tolist(), [0.0] * n)
    for a, b in zip(one, other, strict=True):
        assert a is not None
        assert b is not None
        assert a.distance == pytest.approx(b.distance, rel=1e-6)

"""Which row belongs to which stream: no two sensors share one, and none is lost."""

from __future__ import annotations

from collections.abc import Mapping

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mavcal.calib.errors import FirmwareError
from mavcal.calib.firmware import names
from mavcal.calib.firmware.names import Role
from mavcal.calib.firmware.slots import (
    CALIBRATED,
    ardupilot_calibration_names,
    ardupilot_compass_slot,
    ardupilot_sensor_ids,
    px4_calibration_names,
    px4_instance,
    px4_rows,
    px4_sensor_ids,
    px4_slot,
    px4_thermal_slot,
)
from mavcal.calib.recording import Sensor
from tests.examples import examples

ROWS = range(names.PX4_SLOTS)
HELD = st.lists(st.integers(0, 2**24), min_size=names.PX4_SLOTS, max_size=names.PX4_SLOTS)
SENSORS = st.sampled_from(CALIBRATED)


def px4(sensor: Sensor, ids: list[int], thermal: Mapping[int, int] | None = None) -> dict[str, int]:
    """Parameters of a PX4 with these ids in its rows, and in its thermal rows."""
    found = {names.px4_names(sensor, row)[Role.ID]: held for row, held in enumerate(ids)}
    return found | {names.px4_thermal_names(sensor, row)[Role.THERMAL_ID]: i for row, i in (thermal or {}).items()}


@settings(max_examples=examples(40))
@given(SENSORS, HELD)
def test_every_row_is_of_one_stream_and_filled_rows_come_first(sensor: Sensor, ids: list[int]) -> None:
    parameters = px4(sensor, ids)
    rows = [px4_slot(parameters, sensor, instance) for instance in ROWS]
    assert sorted(rows) == list(ROWS)
    filled = [row for row in rows if ids[row]]
    assert rows[: len(filled)] == sorted(filled)
    with pytest.raises(FirmwareError, match=f"instance {len(ROWS)} has none"):
        px4_slot(parameters, sensor, len(ROWS))
    known = px4_sensor_ids(parameters)
    assert {key: ids[px4_slot(parameters, *key)] for key in known} == known
    assert len(known) == len(filled)


def test_a_device_id_goes_before_the_order() -> None:
    parameters = px4(Sensor.GYRO, [5, 0, 7, 9])
    first, second = (Sensor.GYRO, 0), (Sensor.GYRO, 1)
    assert px4_rows(parameters, Sensor.GYRO) == (0, 2, 3, 1)
    assert px4_rows(parameters, Sensor.GYRO, {first: 9}) == (3, 0, 2, 1)  # the others keep their order
    assert px4_rows(parameters, Sensor.GYRO, {second: 8}) == (0, 1, 2, 3)  # in no row: the free one
    assert px4_rows(parameters, Sensor.GYRO, {(Sensor.ACCEL, 0): 9}) == px4_rows(parameters, Sensor.GYRO)
    with pytest.raises(FirmwareError, match="none is 8: set that of a sensor that is gone to 0"):
        px4_rows(parameters, Sensor.GYRO, {first: 4, second: 8})
    assert px4_sensor_ids(parameters, {second: 9}) == {first: 5, second: 9, (Sensor.GYRO, 2): 7}


@settings(max_examples=examples(40))
@given(SENSORS, HELD, st.dictionaries(st.sampled_from(ROWS), st.integers(1, 9), max_size=4))
def test_told_ids_never_share_a_row_and_take_none_of_another_one(
    sensor: Sensor, ids: list[int], told: dict[int, int]
) -> None:
    parameters = px4(sensor, ids)
    known = {(sensor, i): device for i, device in told.items()}
    if len(set(told.values())) < len(told):
        return  # two with one id: refused before
    try:
        rows = px4_rows(parameters, sensor, known)
    except FirmwareError:
        assert len(set(told.values()) - set(ids)) > ids.count(0)
        return
    assert sorted(rows) == list(ROWS)
    for i, device in told.items():
        assert ids[rows[i]] == device if device in ids else ids[rows[i]] == 0
        assert px4_rows(parameters, sensor)[px4_instance(parameters, sensor, rows[i])] == rows[i]


@settings(max_examples=examples(40))
@given(
    st.sampled_from([Sensor.GYRO, Sensor.ACCEL]),
    st.lists(st.integers(1, 99), min_size=names.PX4_SLOTS, max_size=names.PX4_SLOTS, unique=True),
    st.dictionaries(st.sampled_from(ROWS), st.integers(0, 99), max_size=names.PX4_SLOTS),
)
def test_no_two_sensors_share_a_thermal_row(sensor: Sensor, ids: list[int], thermal: dict[int, int]) -> None:
    parameters = px4(sensor, ids, thermal)
    rows = {device: px4_thermal_slot(parameters, sensor, device) for device in ids}
    taken = [row for row in rows.values() if row is not None]
    assert len(taken) == len(set(taken))
    for device, row in rows.items():
        if device in thermal.values():
            assert thermal[row] == device  # it keeps the one that it has
        elif row is not None:
            assert thermal.get(row, 0) == 0  # or takes a free one


def test_a_sensor_without_an_id_and_a_compass_have_no_thermal_row() -> None:
    assert px4_thermal_slot(px4(Sensor.GYRO, [5, 0, 0, 0]), Sensor.GYRO, 0) is None
    assert px4_thermal_slot(px4(Sensor.MAG, [5, 0, 0, 0]), Sensor.MAG, 5) is None
    full = px4(Sensor.GYRO, [5, 0, 0, 0], {row: 50 + row for row in ROWS})
    assert px4_thermal_slot(full, Sensor.GYRO, 5) is None


def test_the_names_of_a_sensor_are_those_of_both_its_rows() -> None:
    parameters = px4(Sensor.GYRO, [0, 5, 0, 0], {2: 5})
    found = px4_calibration_names(parameters, Sensor.GYRO, 0)
    assert found[Role.ID] == "CAL_GYRO1_ID"
    assert found[Role.THERMAL_ID] == names.px4_thermal_names(Sensor.GYRO, 2)[Role.THERMAL_ID]
    assert Role.THERMAL_ID not in px4_calibration_names(parameters, Sensor.GYRO, 1)  # a free row: no id


@pytest.mark.parametrize("of", [ardupilot_calibration_names, px4_calibration_names])
def test_a_sensor_that_is_not_calibrated_has_no_names(of) -> None:
    with pytest.raises(FirmwareError, match="holds no calibration of temperature"):
        of({}, Sensor.TEMPERATURE, 0)


COMPASSES = {"COMPASS_DEV_ID": 11, "COMPASS_DEV_ID2": 12, "COMPASS_DEV_ID3": 13}


@pytest.mark.parametrize("ranks", [(11, 12, 13), (13, 11, 12), (12, 13, 11)])
def test_a_compass_streams_by_its_rank_and_is_kept_in_its_slot(ranks: tuple[int, ...]) -> None:
    parameters = {**COMPASSES, **{f"COMPASS_PRIO{k + 1}_ID": device for k, device in enumerate(ranks)}}
    assert [ardupilot_compass_slot(parameters, k) for k in range(3)] == [device - 11 for device in ranks]
    found = ardupilot_sensor_ids(parameters)
    assert {k: found[Sensor.MAG, k] for k in range(3)} == dict(enumerate(ranks))
    assert ardupilot_calibration_names(parameters, Sensor.MAG, 0) == names.ardupilot_compass_names(ranks[0] - 11, 0)


def test_without_ranks_slots_are_in_order() -> None:
    assert [ardupilot_compass_slot(COMPASSES, k) for k in range(3)] == [0, 1, 2]
    assert ardupilot_sensor_ids(COMPASSES) == {(Sensor.MAG, k): 11 + k for k in range(3)}


@pytest.mark.parametrize("held", [{}, {"COMPASS_DEV_ID4": 99}])
def test_a_ranked_compass_without_a_slot_of_its_own_is_said(held: dict[str, int]) -> None:
    with pytest.raises(FirmwareError, match=r"compass 2 has device id 99 \(COMPASS_PRIO2_ID\)"):
        ardupilot_compass_slot({**COMPASSES, **held, "COMPASS_PRIO2_ID": 99}, 1)


def test_inertial_units_are_those_with_an_id() -> None:
    ids = {"INS_ACC_ID": 1, "INS_GYR2_ID": 2, "INS_GYR_ID": 0}
    assert ardupilot_sensor_ids(ids) == {(Sensor.ACCEL, 0): 1, (Sensor.GYRO, 1): 2}
    assert ardupilot_calibration_names(ids, Sensor.GYRO, 1) == names.ardupilot_imu_names(Sensor.GYRO, 1)
